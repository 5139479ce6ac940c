#include "tests/golden/trace_replayer.h"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <utility>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_replace.h>
#include <absl/strings/str_split.h>
#include <absl/types/span.h>
#include <nlohmann/json.hpp>

#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "envserver/render/renderer.h"
#include "envserver/render/scene_record.h"
#include "envserver/render/textures.h"
#include "envserver/world/world.h"
#include "tests/fakes/gzip_file.h"
#include "tests/golden/trace_fields.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using nlohmann::json;

struct TraceOptions {
  WorldOptions world;
  RenderOptions render;
};

absl::StatusOr<TraceOptions> OptionsOf(const json& header) {
  TraceOptions options;
  const json none = json::object();
  const json& variant_settings = header.at("ood").is_null() ? none : header.at("ood");
  std::string numbers = variant_settings.value("el_app_freq", "default");
  numbers = absl::StrReplaceAll(numbers, {{"X", "-x"}});  // easyX2 is our easy-x2
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(absl::StrCat("crafter:numbers=", numbers)));
  options.world = WorldOptions::FromEnvName(name);
  options.world.width = header.at("area").at(0).get<int>();
  options.world.height = header.at("area").at(1).get<int>();
  options.world.view_width = header.at("view").at(0).get<int>();
  options.world.view_height = header.at("view").at(1).get<int>();
  options.world.length = header.at("length").get<int>();
  options.world.appearance = variant_settings.value("el_vars", "");
  const std::string frequencies = variant_settings.value("el_freq", "100,0,0,0");
  const std::vector<absl::string_view> parts = absl::StrSplit(frequencies, ',');
  if (parts.size() != options.world.percentages.size()) {
    return absl::InvalidArgumentError(absl::StrCat("el_freq \"", frequencies, "\", want four numbers"));
  }
  for (size_t i = 0; i < parts.size(); ++i) {
    if (!absl::SimpleAtoi(parts[i], &options.world.percentages[i])) {
      return absl::InvalidArgumentError(absl::StrCat("el_freq \"", frequencies, "\", want whole numbers"));
    }
  }
  options.render.width = header.at("size").at(0).get<int>();
  options.render.height = header.at("size").at(1).get<int>();
  options.render.inventory = variant_settings.value("render_scoreboard", true);
  return options;
}

std::vector<uint8_t> Draw(const Renderer& renderer, const World& world, RandomStream* random) {
  std::vector<uint8_t> frame(renderer.frame_bytes());
  renderer.Render(world, random, absl::MakeSpan(frame));
  return frame;
}

// Replays one trace line by line.
class TraceReplayer {
 public:
  TraceReplayer(std::string texture_folder, const GoldenPictures& pictures)
      : texture_folder_(std::move(texture_folder)), pictures_(pictures) {}

  absl::Status Begin(const json& header) {
    CRAFTFLEET_ASSIGN_OR_RETURN(options_, OptionsOf(header));
    CRAFTFLEET_ASSIGN_OR_RETURN(textures_, Textures::Load(texture_folder_));
    CRAFTFLEET_ASSIGN_OR_RETURN(renderer_, Renderer::Create(*textures_, options_.world, options_.render));
    CRAFTFLEET_ASSIGN_OR_RETURN(world_, World::Create(options_.world, header.at("seed").get<int64_t>()));
    return absl::OkStatus();
  }

  // Replays one line. Sets report().difference at the first difference.
  absl::Status Replay(const json& line) {
    const std::string kind = line.at("k").get<std::string>();
    if (kind == "set") return WorldEditor::Apply(line, &*world_);
    StepOutcome outcome;
    if (kind == "s") {
      const int action = line.at("a").get<int>();
      if (action < 0 || action >= kNumActions) {
        return absl::InvalidArgumentError(absl::StrCat("action ", action, ", want 0..", kNumActions - 1));
      }
      outcome = world_->Step(static_cast<Action>(action));
    } else if (kind == "reset") {
      if (reset_before_) world_->Reset();
      reset_before_ = true;
    } else if (kind != "state") {
      return absl::InvalidArgumentError(absl::StrCat("line of unknown kind \"", kind, "\""));
    }
    if (kind != "state") CRAFTFLEET_RETURN_IF_ERROR(DrawObservation(kind == "reset"));
    Compare(line, outcome);
    if (report_.difference.empty() && kind != "state") CRAFTFLEET_RETURN_IF_ERROR(ComparePictures(line));
    if (report_.difference.empty() && kind == "s") ++report_.steps;
    return absl::OkStatus();
  }

  const ReplayReport& report() const { return report_; }

 private:
  // Draws the observation. From its record, a receiver must draw the same.
  absl::Status DrawObservation(bool is_reset) {
    if (is_reset) writer_.Restart();
    renderer_->Capture(*world_, &scene_);
    std::string record;
    writer_.Append(*renderer_, scene_, world_->random(), &record);
    frame_ = Draw(*renderer_, *world_, &world_->random());
    std::vector<uint8_t> received(renderer_->frame_bytes());
    absl::string_view rest = record;
    CRAFTFLEET_RETURN_IF_ERROR(reader_.Draw(*renderer_, &rest, absl::MakeSpan(received)));
    if (received == frame_ && rest.empty()) return absl::OkStatus();
    return absl::DataLossError("the picture drawn from its scene record differs");
  }

  void Compare(const json& line, const StepOutcome& outcome) {
    json found = TraceFields(*world_);
    found["r"] = outcome.reward;
    found["d"] = outcome.end == StepEnd::kNone ? 0 : 1;
    found["img"] = CrcText(frame_);
    for (const auto& [key, expected] : line.items()) {
      if (key == "k" || key == "g" || key == "a" || expected == found[key]) continue;
      return Differ(line, key, expected.dump(), found[key].dump());
    }
    report_.frames += line.contains("img") ? 1 : 0;
  }

  absl::Status ComparePictures(const json& line) {
    const auto picked = pictures_.find({line.at("g").get<int64_t>(), line.value("n", int64_t{0})});
    if (picked == pictures_.end()) return absl::OkStatus();
    for (const GoldenPicture& picture : picked->second) {
      std::vector<uint8_t> drawn = frame_;
      if (picture.extra) {
        RenderOptions options = options_.render;
        options.width = picture.width;
        options.height = picture.height;
        CRAFTFLEET_ASSIGN_OR_RETURN(const auto renderer, Renderer::Create(*textures_, options_.world, options));
        RandomStream random = world_->random();
        drawn = Draw(*renderer, *world_, &random);
      }
      if (!ComparePicture(line, picture, drawn)) return absl::OkStatus();
      ++report_.frames;
    }
    return absl::OkStatus();
  }

  bool ComparePicture(const json& line, const GoldenPicture& picture, absl::Span<const uint8_t> drawn) {
    const std::string size = absl::StrCat(picture.width, "x", picture.height);
    if (drawn.size() != picture.bytes.size()) {
      Differ(line, absl::StrCat("picture ", size), absl::StrCat(picture.bytes.size(), " bytes"),
             absl::StrCat(drawn.size(), " bytes"));
      return false;
    }
    for (size_t i = 0; i < drawn.size(); ++i) {
      const auto expected = static_cast<uint8_t>(picture.bytes[i]);
      if (drawn[i] == expected) continue;
      const size_t pixel = i / 3;
      Differ(line,
             absl::StrCat("picture ", size, " pixel (", pixel % picture.width, ", ", pixel / picture.width, ")[", i % 3,
                          "]"),
             absl::StrCat(expected), absl::StrCat(drawn[i]));
      return false;
    }
    return true;
  }

  void Differ(const json& line, absl::string_view field, absl::string_view expected, absl::string_view found) {
    report_.difference = absl::StrCat("step ", line.value("g", int64_t{-1}), " (", line.value("k", ""), " line, step ",
                                      line.value("n", int64_t{0}), " of its episode) ", field, ": expected ", expected,
                                      ", found ", found);
  }

  const std::string texture_folder_;
  const GoldenPictures& pictures_;
  TraceOptions options_;
  std::shared_ptr<const Textures> textures_;
  std::shared_ptr<const Renderer> renderer_;
  std::optional<World> world_;  // set by Begin()
  bool reset_before_ = false;   // a world is made in its first episode
  std::vector<uint8_t> frame_;
  Scene scene_;
  SceneWriter writer_;
  SceneReader reader_;
  ReplayReport report_;
};

absl::StatusOr<ReplayReport> ReplayLines(absl::string_view text, const std::string& texture_folder,
                                         const GoldenPictures& pictures) {
  TraceReplayer replayer(texture_folder, pictures);
  int number = 0;
  for (const absl::string_view line : absl::StrSplit(text, '\n', absl::SkipEmpty())) {
    ++number;
    absl::Status status;
    try {
      const json parsed = json::parse(line);
      status = number == 1 ? replayer.Begin(parsed) : replayer.Replay(parsed);
    } catch (const json::exception& error) {
      status = absl::DataLossError(error.what());
    }
    if (!status.ok()) return absl::Status(status.code(), absl::StrCat("line ", number, ": ", status.message()));
    if (!replayer.report().difference.empty()) break;
  }
  if (number < 2) return absl::DataLossError("no lines to replay");
  return replayer.report();
}

// The pictures of each trace listed in a frames.jsonl, by the trace's file name.
absl::StatusOr<std::map<std::string, GoldenPictures>> LoadPictures(const std::string& path) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadGzipFile(path));
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  std::map<std::string, std::string> bins;
  std::map<std::string, GoldenPictures> pictures;
  try {
    for (const absl::string_view line : absl::StrSplit(text, '\n', absl::SkipEmpty())) {
      const json row = json::parse(line);
      GoldenPictures& of_trace = pictures[row.at("trace").get<std::string>()];
      for (const json& frame : row.at("frames")) {
        const auto bin = frame.at("bin").get<std::string>();
        if (bins.count(bin) == 0) {
          CRAFTFLEET_ASSIGN_OR_RETURN(bins[bin], ReadGzipFile((folder / (bin + ".gz")).string()));
        }
        GoldenPicture picture;
        picture.width = frame.at("w").get<int>();
        picture.height = frame.at("h").get<int>();
        picture.extra = frame.at("kind").get<std::string>() == "extra";
        const auto offset = frame.at("off").get<size_t>();
        if (offset <= bins[bin].size()) picture.bytes = bins[bin].substr(offset, 3 * picture.width * picture.height);
        if (CrcText(picture.bytes) != frame.at("crc").get<std::string>()) {
          return absl::DataLossError(
              absl::StrCat(path, ": ", bin, " at ", offset, " does not have crc ", frame.at("crc").get<std::string>()));
        }
        of_trace[{row.at("g").get<int64_t>(), row.at("n").get<int64_t>()}].push_back(std::move(picture));
      }
    }
  } catch (const json::exception& error) {
    return absl::DataLossError(absl::StrCat(path, ": ", error.what()));
  }
  return pictures;
}

}  // namespace

absl::StatusOr<ReplayReport> ReplayTrace(const std::string& path, const std::string& texture_folder,
                                         const GoldenPictures& pictures) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadGzipFile(path));
  absl::StatusOr<ReplayReport> report = ReplayLines(text, texture_folder, pictures);
  if (report.ok()) return report;
  return absl::Status(report.status().code(), absl::StrCat(path, ": ", report.status().message()));
}

absl::StatusOr<ReplayReport> ReplayFrames(const std::string& path, const std::string& texture_folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto pictures, LoadPictures(path));
  ReplayReport total;
  for (const auto& [trace, of_trace] : pictures) {
    const std::string trace_path = (std::filesystem::path(path).parent_path() / trace).string();
    CRAFTFLEET_ASSIGN_OR_RETURN(const ReplayReport report, ReplayTrace(trace_path, texture_folder, of_trace));
    total.steps += report.steps;
    total.frames += report.frames;
    if (!report.difference.empty()) {
      total.difference = absl::StrCat(trace, ": ", report.difference);
      break;
    }
  }
  return total;
}

}  // namespace craftfleet
