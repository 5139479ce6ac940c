#include "common/process/help.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>

#include <absl/flags/reflection.h>
#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_replace.h>
#include <absl/strings/strip.h>
#include <nlohmann/json.hpp>

#include "common/base/check.h"
#include "common/process/flag_values.h"

namespace craftfleet {
namespace {

// A flag, and what its help says.
struct Flag {
  const absl::CommandLineFlag* flag;
  std::string help;

  const absl::CommandLineFlag* operator->() const { return flag; }
};

struct FlagGroups {
  std::vector<Flag> main;
  std::vector<Flag> other;
};

FlagGroups GroupFlags(const ProgramHelp& program) {
  std::map<absl::string_view, Flag> others;
  for (const auto& [name, flag] : absl::GetAllFlags()) {
    if (HasFlag(program, *flag)) others[name] = {flag, flag->Help()};
  }
  for (const auto& [name, text] : program.texts) others.at(name).help = std::string(text);
  FlagGroups groups;
  for (const absl::string_view name : program.main_flags) {
    CRAFTFLEET_CHECK(others.count(name) == 1);
    groups.main.push_back(others[name]);
    others.erase(name);
  }
  for (const auto& [name, flag] : others) {
    const std::string file = flag->Filename();
    const bool shared = absl::EndsWith(file, "_flags.cc") || absl::EndsWith(file, "process/program.cc");
    (program.main_flags.empty() && !shared ? groups.main : groups.other).push_back(flag);
  }
  return groups;
}

const char* TypeOf(const absl::CommandLineFlag& flag) {
  if (flag.IsOfType<bool>()) return "bool";
  if (flag.IsOfType<int32_t>() || flag.IsOfType<int64_t>() || flag.IsOfType<uint64_t>() || flag.IsOfType<Count>() ||
      flag.IsOfType<std::optional<int32_t>>() || flag.IsOfType<std::optional<uint64_t>>() ||
      flag.IsOfType<std::optional<Count>>()) {
    return "integer";
  }
  if (flag.IsOfType<double>()) return "number";
  if (flag.IsOfType<TimeSpan>()) return "duration";
  return flag.IsOfType<std::vector<std::string>>() ? "list" : "string";
}

// "[16]" at the end of a help text: a default that the flag's own value does not show.
absl::string_view BracketedEnd(absl::string_view help) {
  const size_t start = help.rfind('[');
  return absl::EndsWith(help, "]") && start != absl::string_view::npos ? help.substr(start) : "";
}

// The first line of the help text, followed by the bracketed default.
std::string OneLine(const std::string& help) {
  const size_t end = help.find('\n');
  if (end == std::string::npos) return help;
  const absl::string_view bracketed = BracketedEnd(help);
  return absl::StrCat(absl::StripSuffix(absl::StripSuffix(help.substr(0, end), ";"), ","), bracketed.empty() ? "" : " ",
                      absl::StrReplaceAll(bracketed, {{"\n", " "}}));
}

std::string WithDefault(const Flag& flag) {
  const std::string value = flag->DefaultValue();
  return value.empty() ? absl::StrCat("--", flag->Name()) : absl::StrFormat("--%s (default %s)", flag->Name(), value);
}

std::string Details(const std::vector<Flag>& flags) {
  std::string text;
  for (const Flag& flag : flags) {
    absl::StrAppendFormat(&text, "  %s\n      %s\n", WithDefault(flag),
                          absl::StrReplaceAll(flag.help, {{"\n", "\n      "}}));
  }
  return text;
}

}  // namespace

bool HasFlag(const ProgramHelp& program, const absl::CommandLineFlag& flag) {
  const std::string file = flag.Filename();
  if (absl::StrContains(file, "absl/")) return false;  // those that Abseil defines for itself
  const auto names_it = [&](absl::string_view part) { return part == flag.Name() || absl::EndsWith(file, part); };
  return absl::EndsWith(file, "process/program.cc") ||
         std::any_of(program.main_flags.begin(), program.main_flags.end(), names_it) ||
         std::any_of(program.more_flags.begin(), program.more_flags.end(), names_it);
}

std::string ShortHelp(const ProgramHelp& program) {
  const FlagGroups groups = GroupFlags(program);
  size_t width = 0;
  for (const Flag& flag : groups.main) width = std::max(width, WithDefault(flag).size());
  std::string text = absl::StrCat(program.usage, "\n");
  if (!groups.main.empty()) absl::StrAppend(&text, "\nFlags:\n");
  for (const Flag& flag : groups.main) {
    absl::StrAppendFormat(&text, "  %-*s  %s\n", static_cast<int>(width), WithDefault(flag), OneLine(flag.help));
  }
  absl::StrAppendFormat(&text, "\n%s --helpfull explains all %d flags in full; --version shows the version.\n",
                        program.name, groups.main.size() + groups.other.size());
  return text;
}

std::string FullHelp(const ProgramHelp& program) {
  const FlagGroups groups = GroupFlags(program);
  std::string text = absl::StrCat(program.usage, "\n");
  if (!groups.main.empty()) absl::StrAppend(&text, "\nFlags of ", program.name, ":\n", Details(groups.main));
  if (!groups.other.empty()) absl::StrAppend(&text, "\nMore flags:\n", Details(groups.other));
  absl::StrAppend(&text, "\n  --help, --helpfull, --version\n");
  return text;
}

std::string HelpJson(const ProgramHelp& program) {
  nlohmann::ordered_json json = {{"program", std::string(program.name)}, {"usage", std::string(program.usage)}};
  nlohmann::ordered_json flags = nlohmann::ordered_json::array();
  const FlagGroups groups = GroupFlags(program);
  const auto add = [&flags](const std::vector<Flag>& group, const char* name) {
    for (const Flag& flag : group) {
      flags.push_back({{"name", std::string(flag->Name())},
                       {"type", TypeOf(*flag.flag)},
                       {"default", flag->DefaultValue()},
                       {"help", flag.help},
                       {"group", name}});
    }
  };
  add(groups.main, "main");
  add(groups.other, "other");
  json["flags"] = std::move(flags);
  return json.dump(2, ' ', /*ensure_ascii=*/false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace craftfleet
