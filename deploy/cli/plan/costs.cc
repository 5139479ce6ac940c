#include "deploy/cli/plan/costs.h"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <utility>
#include <vector>

#include <absl/strings/ascii.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <google/protobuf/text_format.h>
#include <nlohmann/json.hpp>

#include "common/base/status_macros.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

constexpr double kMaxNumber = 1e12;

struct Number {
  const char* name;
  double* value;
};

struct OptionalNumber {
  const char* name;
  std::optional<double>* value;
};

std::vector<Number> NumbersOf(Costs* costs) {
  return {{"update_us", &costs->update_us}, {"act_us", &costs->act_us}, {"weight_bytes", &costs->weight_bytes}};
}

std::vector<OptionalNumber> OptionalNumbersOf(Costs* costs) {
  return {{"two_thread_us", &costs->two_thread_us}, {"gpu_update_us", &costs->gpu_update_us}};
}

std::vector<Number> NumbersOf(FrameCosts* costs) {
  return {{"server_us", &costs->server_us},
          {"game_us", &costs->game_us},
          {"actor_us", &costs->actor_us},
          {"learner_us", &costs->learner_us},
          {"bytes", &costs->bytes}};
}

std::vector<std::pair<const char*, std::string*>> TextsOf(Costs* costs) {
  return {{"cpu", &costs->cpu}, {"build", &costs->build}, {"config", &costs->config}, {"measured", &costs->measured}};
}

// Reads fields of one object. `prefix` is before their names in errors.
class Reader {
 public:
  Reader(const nlohmann::json& object, absl::string_view path, absl::string_view prefix)
      : object_(object), path_(path), prefix_(prefix) {}

  absl::Status Text(const char* name, std::string* value) const {
    const auto found = object_.find(name);
    if (found == object_.end() || !found->is_string()) return Wants(name, "a text");
    *value = found->get<std::string>();
    return absl::OkStatus();
  }

  absl::Status Read(const Number& number) const {
    const auto found = object_.find(number.name);
    const double value = found != object_.end() && found->is_number() ? found->get<double>() : 0;
    if (!std::isfinite(value) || value <= 0 || value > kMaxNumber) {
      return Wants(number.name, absl::StrFormat("a number above 0, at most %g", kMaxNumber));
    }
    *number.value = value;
    return absl::OkStatus();
  }

  absl::Status Read(const OptionalNumber& number) const {
    if (!object_.contains(number.name)) return absl::OkStatus();
    double value = 0;
    CRAFTFLEET_RETURN_IF_ERROR(Read(Number{number.name, &value}));
    *number.value = value;
    return absl::OkStatus();
  }

 private:
  absl::Status Wants(const char* name, absl::string_view what) const {
    return absl::InvalidArgumentError(absl::StrCat(path_, ": ", prefix_, name, ", want ", what));
  }

  const nlohmann::json& object_;
  const absl::string_view path_;
  const absl::string_view prefix_;
};

absl::Status ReadFrameCosts(const nlohmann::json& json, const char* name, absl::string_view path, FrameCosts* costs) {
  const auto found = json.find(name);
  if (found == json.end() || !found->is_object()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", name, ", want an object"));
  }
  const std::string prefix = absl::StrCat(name, ".");
  const Reader reader(*found, path, prefix);
  for (const Number& number : NumbersOf(costs)) CRAFTFLEET_RETURN_IF_ERROR(reader.Read(number));
  return absl::OkStatus();
}

}  // namespace

std::string CostlyFields(const v1::RunConfig& config) {
  v1::RunConfig fields = config;
  fields.clear_steps();
  fields.clear_seed();
  fields.clear_lanes();
  fields.clear_fragment_steps();  // follows from lanes; only very short fragments cost more
  fields.clear_checkpoint();
  fields.clear_eval();
  fields.clear_distillation();
  fields.clear_device();
  fields.clear_overlap();
  fields.clear_max_staleness();
  fields.clear_ppo();
  fields.mutable_ppo()->set_minibatch_size(config.ppo().minibatch_size());
  google::protobuf::TextFormat::Printer printer;
  printer.SetSingleLineMode(true);
  std::string text;
  printer.PrintToString(fields, &text);
  absl::StripTrailingAsciiWhitespace(&text);
  return text;
}

std::string FormatCosts(const Costs& costs) {
  Costs copy = costs;  // the tables of fields point to what can be changed
  nlohmann::ordered_json json;
  for (const auto& [name, text] : TextsOf(&copy)) json[name] = *text;
  for (const Number& number : NumbersOf(&copy)) json[number.name] = *number.value;
  for (const OptionalNumber& number : OptionalNumbersOf(&copy)) {
    if (number.value->has_value()) json[number.name] = **number.value;
  }
  for (const FrameFormat format : kFrameFormats) {
    for (const Number& number : NumbersOf(&copy[format])) json[FrameFormatName(format)][number.name] = *number.value;
  }
  return json.dump(2, ' ', /*ensure_ascii=*/false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

absl::StatusOr<Costs> ParseCosts(absl::string_view text, absl::string_view path) {
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not the JSON that craftfleet plan writes"));
  }
  Costs costs;
  const Reader reader(json, path, "");
  for (const auto& [name, value] : TextsOf(&costs)) CRAFTFLEET_RETURN_IF_ERROR(reader.Text(name, value));
  for (const Number& number : NumbersOf(&costs)) CRAFTFLEET_RETURN_IF_ERROR(reader.Read(number));
  for (const OptionalNumber& number : OptionalNumbersOf(&costs)) CRAFTFLEET_RETURN_IF_ERROR(reader.Read(number));
  for (const FrameFormat format : kFrameFormats) {
    CRAFTFLEET_RETURN_IF_ERROR(ReadFrameCosts(json, FrameFormatName(format), path, &costs[format]));
  }
  return costs;
}

absl::Status KeepCosts(const Costs& costs, const std::string& path) {
  const std::string folder = std::filesystem::path(path).parent_path();
  if (!folder.empty()) CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  return ReplaceFile(path, FormatCosts(costs));
}

absl::StatusOr<std::string> DefaultCostsPath(absl::string_view agent) {
  const char* cache = std::getenv("XDG_CACHE_HOME");
  const char* home = std::getenv("HOME");
  std::string folder;
  if (cache != nullptr && *cache != '\0') {
    folder = cache;
  } else if (home != nullptr && *home != '\0') {
    folder = JoinPath(home, ".cache");
  } else {
    return absl::FailedPreconditionError(
        "neither XDG_CACHE_HOME nor HOME is set: say with --costs where to keep costs");
  }
  return JoinPath(folder, absl::StrCat("craftfleet/costs/", agent, ".json"));
}

}  // namespace craftfleet
