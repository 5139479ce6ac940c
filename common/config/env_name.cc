#include "common/config/env_name.h"

#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kGame = "crafter";
constexpr absl::string_view kOptions =
    "appearance=A/B/C/D (percentages of the four variants, sum 100), numbers=SETTING, inventory=on|off";
struct NumberSetting {
  absl::string_view name;
  absl::string_view letters;
};
constexpr NumberSetting kNumberSettings[] = {{"default", "sssss"}, {"easy-x2", "dddhh"}, {"easy-x4", "fffqq"},
                                             {"mix", "fffff"},     {"hard-x2", "hhhdd"}, {"hard-x4", "qqqff"}};

std::string NumberSettings() {
  return absl::StrJoin(kNumberSettings, ", ",
                       [](std::string* out, const NumberSetting& setting) { absl::StrAppend(out, setting.name); });
}

absl::Status ParseAppearance(absl::string_view value, EnvName* name) {
  const std::vector<absl::string_view> parts = absl::StrSplit(value, '/');
  int sum = 0;
  bool valid = parts.size() == name->percentages.size();
  for (size_t i = 0; valid && i < parts.size(); ++i) {
    int& percentage = name->percentages[i];
    valid = absl::SimpleAtoi(parts[i], &percentage) && percentage >= 0 && percentage <= 100;
    sum += percentage;
  }
  if (!valid || sum != 100) {
    return absl::InvalidArgumentError(
        absl::StrCat("appearance \"", value, "\", want four whole percentages that sum to 100, like 25/25/25/25"));
  }
  name->appearance = true;
  return absl::OkStatus();
}

absl::Status ParseNumbers(absl::string_view value, EnvName* name) {
  for (const NumberSetting& setting : kNumberSettings) {
    if (value == setting.name) {
      name->numbers = absl::StrCat(setting.letters);
      return absl::OkStatus();
    }
  }
  if (value.size() != name->numbers.size() || value.find_first_not_of("qhsdf") != absl::string_view::npos) {
    return absl::InvalidArgumentError(absl::StrCat("numbers \"", value, "\", want one of ", NumberSettings(),
                                                   ", or five letters of q h s d f for tree, coal, cow, zombie, "
                                                   "skeleton"));
  }
  name->numbers = absl::StrCat(value);
  return absl::OkStatus();
}

absl::Status ParseInventory(absl::string_view value, EnvName* name) {
  if (value != "on" && value != "off") {
    return absl::InvalidArgumentError(absl::StrCat("inventory \"", value, "\", want on or off"));
  }
  name->inventory = value == "on";
  return absl::OkStatus();
}

absl::Status ParseOption(absl::string_view option, EnvName* name) {
  const std::pair<absl::string_view, absl::string_view> parts = absl::StrSplit(option, absl::MaxSplits('=', 1));
  if (parts.first == "appearance") return ParseAppearance(parts.second, name);
  if (parts.first == "numbers") return ParseNumbers(parts.second, name);
  if (parts.first == "inventory") return ParseInventory(parts.second, name);
  return absl::InvalidArgumentError(absl::StrCat("unknown option \"", option, "\", want one of ", kOptions));
}

}  // namespace

absl::StatusOr<EnvName> EnvName::Parse(absl::string_view name) {
  const auto in_name = [name](absl::string_view message) {
    return absl::InvalidArgumentError(absl::StrCat("environment \"", name, "\": ", message));
  };
  const size_t colon = name.find(':');
  if (name.substr(0, colon) != kGame) {
    return in_name(absl::StrCat("unknown game \"", name.substr(0, colon), "\", want \"", kGame, "\""));
  }
  EnvName parsed;
  if (colon == absl::string_view::npos) return parsed;
  std::vector<absl::string_view> seen;
  for (const absl::string_view option : absl::StrSplit(name.substr(colon + 1), ',')) {
    const absl::Status status = ParseOption(option, &parsed);
    if (!status.ok()) return in_name(status.message());
    const absl::string_view key = option.substr(0, option.find('='));
    for (const absl::string_view other : seen) {
      if (key == other) return in_name(absl::StrCat("option \"", key, "\" is given twice"));
    }
    seen.push_back(key);
  }
  return parsed;
}

std::string EnvName::ToString() const {
  std::vector<std::string> options;
  if (appearance) options.push_back(absl::StrCat("appearance=", absl::StrJoin(percentages, "/")));
  if (numbers != EnvName().numbers) {
    absl::string_view setting = numbers;
    for (const NumberSetting& named : kNumberSettings) {
      if (numbers == named.letters) setting = named.name;
    }
    options.push_back(absl::StrCat("numbers=", setting));
  }
  if (!inventory) options.push_back("inventory=off");
  return absl::StrCat(kGame, options.empty() ? "" : ":", absl::StrJoin(options, ","));
}

std::string EnvName::WorldName() const {
  EnvName world = *this;
  world.inventory = true;
  return world.ToString();
}

}  // namespace craftfleet
