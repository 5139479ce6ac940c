// Every golden trace and picture of the reference game, replayed. They need the reference's textures, which are not
// part of this project: without CRAFTFLEET_GOLDEN_DIR the tests are skipped. Source: the README there.

#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_replace.h>
#include <absl/strings/str_split.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/config/env_name.h"
#include "envserver/render/renderer.h"
#include "envserver/render/scene_record.h"
#include "envserver/world/world.h"
#include "tests/fakes/cpu_paths.h"
#include "tests/fakes/gzip_file.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/trace_fields.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::vector<json> Lines(const fs::path& path) {
  const auto text = ReadGzipFile(path.string());
  EXPECT_THAT(text, IsOk());
  std::vector<json> lines;
  for (const absl::string_view line : absl::StrSplit(text.value_or(""), '\n', absl::SkipEmpty())) {
    lines.push_back(json::parse(line));
  }
  return lines;
}

// A picture that the reference drew in one step of a trace.
struct Picture {
  RenderOptions size;
  bool extra;         // drawn beside the observation, from a copy of the stream as it was after it
  std::string bytes;  // uint8[height][width][3]
};
// By (steps in the file so far, step of the episode).
using Pictures = std::map<std::pair<int64_t, int64_t>, std::vector<Picture>>;

WorldOptions WorldOf(const json& header, const json& variants) {
  const std::string numbers = absl::StrReplaceAll(variants.value("el_app_freq", "default"), {{"X", "-x"}});
  WorldOptions options = WorldOptions::FromEnvName(*EnvName::Parse("crafter:numbers=" + numbers));
  options.width = header.at("area").at(0);
  options.height = header.at("area").at(1);
  options.view_width = header.at("view").at(0);
  options.view_height = header.at("view").at(1);
  options.length = header.at("length");
  options.appearance = variants.value("el_vars", "");
  const std::vector<std::string> parts = absl::StrSplit(variants.value("el_freq", "100,0,0,0"), ',');
  for (size_t i = 0; i < options.percentages.size(); ++i) {
    EXPECT_TRUE(absl::SimpleAtoi(parts.at(i), &options.percentages[i]));
  }
  return options;
}

// Replays one trace line by line.
class TraceReplayer {
 public:
  TraceReplayer(const json& header, std::shared_ptr<const Textures> textures, const Pictures& pictures)
      : textures_(std::move(textures)), pictures_(pictures) {
    const json variants = header.at("ood").is_null() ? json::object() : header.at("ood");
    render_.width = header.at("size").at(0);
    render_.height = header.at("size").at(1);
    render_.inventory = variants.value("render_scoreboard", true);
    world_ = *World::Create(WorldOf(header, variants), header.at("seed").get<int64_t>());
    renderer_ = *Renderer::Create(*textures_, world_->options(), render_);
  }

  void Replay(const json& line) {
    const std::string kind = line.at("k");
    if (kind == "set") {
      ASSERT_THAT(WorldEditor::Apply(line, &*world_), IsOk());
      return;
    }
    StepOutcome outcome;
    if (kind == "s") {
      outcome = world_->Step(static_cast<Action>(line.at("a").get<int>()));
      ++steps_;
    } else if (kind == "reset") {
      if (std::exchange(reset_before_, true)) world_->Reset();
      writer_.Restart();
    } else {
      ASSERT_EQ(kind, "state");
    }
    if (kind != "state") {
      ASSERT_NO_FATAL_FAILURE(DrawObservation());
    }
    json found = TraceFields(*world_);
    found["r"] = outcome.reward;
    found["d"] = outcome.end == StepEnd::kNone ? 0 : 1;
    found["img"] = CrcText(frame_);
    for (const auto& [key, expected] : line.items()) {
      if (key == "k" || key == "g" || key == "a") continue;
      ASSERT_EQ(found[key], expected) << key << " of " << line.dump();
    }
    if (kind != "state") ComparePictures(line);
  }
  int steps() const { return steps_; }
  int pictures() const { return compared_; }

 private:
  // Draws the observation. From its record, a receiver must draw the same.
  void DrawObservation() {
    renderer_->Capture(*world_, &scene_);
    std::string record;
    writer_.Append(*renderer_, scene_, world_->random(), &record);
    frame_.resize(renderer_->frame_bytes());
    renderer_->Render(*world_, &world_->random(), absl::MakeSpan(frame_));
    std::vector<uint8_t> received(frame_.size());
    absl::string_view rest = record;
    ASSERT_THAT(reader_.Draw(*renderer_, &rest, absl::MakeSpan(received)), IsOk());
    ASSERT_TRUE(received == frame_ && rest.empty()) << "drawn from its scene record";
  }

  void ComparePictures(const json& line) {
    const auto picked = pictures_.find({line.at("g").get<int64_t>(), line.value("n", int64_t{0})});
    if (picked == pictures_.end()) return;
    for (const Picture& picture : picked->second) {
      std::vector<uint8_t> drawn = frame_;
      if (picture.extra) {
        RenderOptions options = render_;
        options.width = picture.size.width;
        options.height = picture.size.height;
        const auto renderer = *Renderer::Create(*textures_, world_->options(), options);
        RandomStream random = world_->random();
        drawn.resize(renderer->frame_bytes());
        renderer->Render(*world_, &random, absl::MakeSpan(drawn));
      }
      ASSERT_EQ(drawn.size(), picture.bytes.size());
      for (size_t i = 0; i < drawn.size(); ++i) {
        ASSERT_EQ(drawn[i], static_cast<uint8_t>(picture.bytes[i]))
            << "x " << i / 3 % picture.size.width << ", y " << i / 3 / picture.size.width << ", channel " << i % 3;
      }
      ++compared_;
    }
  }

  const std::shared_ptr<const Textures> textures_;
  const Pictures& pictures_;
  RenderOptions render_;
  std::shared_ptr<const Renderer> renderer_;
  std::optional<World> world_;
  bool reset_before_ = false;  // a world is made in its first episode
  std::vector<uint8_t> frame_;
  Scene scene_;
  SceneWriter writer_;
  SceneReader reader_;
  int steps_ = 0;
  int compared_ = 0;
};

class Golden : public OnEachCpuPath {
 protected:
  void SetUp() override {
    OnEachCpuPath::SetUp();
    const char* folder = std::getenv("CRAFTFLEET_GOLDEN_DIR");
    if (folder == nullptr) GTEST_SKIP() << "CRAFTFLEET_GOLDEN_DIR is not set";
    golden_ = folder;
  }

  // Returns the number of pictures that agree.
  int Replay(const fs::path& trace, const std::string& textures, const Pictures& pictures) const {
    const std::vector<json> lines = Lines(trace);
    if (lines.size() < 2) ADD_FAILURE() << trace << " has nothing to replay";
    const std::string folder = (golden_ / ".." / "assets" / textures).string();
    TraceReplayer replayer(lines.at(0), *Textures::Load(folder), pictures);
    for (size_t i = 1; i < lines.size() && !HasFatalFailure(); ++i) {
      SCOPED_TRACE(absl::StrCat(trace.string(), ": line ", i + 1));
      replayer.Replay(lines[i]);
    }
    EXPECT_GT(replayer.steps(), 0) << trace;
    return replayer.pictures();
  }

  // Reads the pictures that the folder's frames.jsonl lists, by their trace.
  static void ReadPictures(const fs::path& folder, std::map<std::string, Pictures>* traces, int* count) {
    std::map<std::string, std::string> bins;
    for (const json& row : Lines(folder / "frames.jsonl")) {
      for (const json& frame : row.at("frames")) {
        const std::string name = frame.at("bin");
        if (bins[name].empty()) bins[name] = *ReadGzipFile((folder / (name + ".gz")).string());
        Picture picture;
        picture.size.width = frame.at("w");
        picture.size.height = frame.at("h");
        picture.extra = frame.at("kind") == "extra";
        picture.bytes =
            bins[name].substr(frame.at("off").get<size_t>(), size_t{3} * picture.size.width * picture.size.height);
        ASSERT_EQ(CrcText(picture.bytes), frame.at("crc"));
        (*traces)[row.at("trace").get<std::string>()][{row.at("g").get<int64_t>(), row.at("n").get<int64_t>()}]
            .push_back(picture);
        ++*count;
      }
    }
    EXPECT_GT(*count, 0);
  }

  void ReplayAll(const std::string& subfolder, int num_traces, bool has_pictures = true) const {
    const fs::path folder = golden_ / "crafter" / subfolder;
    std::map<std::string, Pictures> pictures;
    int wanted = 0;
    if (has_pictures) {
      ASSERT_NO_FATAL_FAILURE(ReadPictures(folder, &pictures, &wanted));
    }
    int replayed = 0;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
      const std::string name = entry.path().filename();
      if (!absl::EndsWith(name, ".jsonl.gz")) continue;
      const bool variants = subfolder == "ood" || absl::StrContains(name, "scenario-ood");
      wanted -= Replay(entry.path(), variants ? "crafter-ood" : "crafter", pictures[name]);
      ++replayed;
    }
    EXPECT_EQ(replayed, num_traces);
    EXPECT_EQ(wanted, 0) << "pictures of steps that no trace has";
  }

  fs::path golden_;
};

CRAFTFLEET_ON_EACH_CPU_PATH(Golden);

TEST_P(Golden, PlainGamesReplayFieldByFieldWithTheirPictures) { ReplayAll("", 32); }
TEST_P(Golden, FarmsReplayFieldByFieldWithTheirPictures) { ReplayAll("farm", 4); }
TEST_P(Golden, AFullLengthEpisodeReplaysFieldByFieldWithItsPictures) { ReplayAll("long", 1); }
TEST_P(Golden, VariantGamesReplayFieldByFieldWithTheirPictures) { ReplayAll("ood", 16); }
TEST_P(Golden, StagedSituationsReplayFieldByField) { ReplayAll("scenario", 21, /*has_pictures=*/false); }

}  // namespace
}  // namespace craftfleet
