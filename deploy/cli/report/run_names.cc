#include "deploy/cli/report/run_names.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/strings/string_view.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/text_format.h>

#include "common/config/config.h"
#include "common/config/known_canary.h"
#include "deploy/cli/plot/curve_chart.h"
#include "deploy/cli/sweep/run_identity.h"

namespace craftfleet {
namespace {

constexpr size_t kShownSettings = 3;
constexpr char kTextures[] = "textures";

using Settings = std::map<std::string, std::string>;  // "ppo.gamma" -> "0.95"

const RunRecord& FirstRun(const RunGroup& group) {
  return *(group.complete.empty() ? group.incomplete : group.complete).front();
}

std::vector<std::string> FoldersOf(const RunGroup& group) {
  std::vector<std::string> folders;
  for (const auto* runs : {&group.complete, &group.incomplete}) {
    for (const RunRecord* run : *runs) folders.push_back(run->folder);
  }
  std::sort(folders.begin(), folders.end());
  return folders;
}

std::string Parent(const std::string& folder) {
  const size_t slash = folder.find_last_of('/');
  return slash == std::string::npos ? "" : folder.substr(0, slash);
}

// "seed7"
bool IsSeedFolder(absl::string_view folder) {
  const absl::string_view name = folder.substr(folder.find_last_of('/') + 1);
  return name.size() > 4 && absl::StartsWith(name, "seed") &&
         std::all_of(name.begin() + 4, name.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
}

// The deepest folder that contains all of `folders`. For a single run, its own folder, or the parent of one such as
// "seed7". Empty if there is none.
std::string CommonFolder(const std::vector<std::string>& folders) {
  std::string common = folders.size() > 1 || IsSeedFolder(folders[0]) ? Parent(folders[0]) : folders[0];
  const auto has_all = [&] {
    return std::all_of(folders.begin(), folders.end(), [&](const std::string& folder) {
      return folder == common || absl::StartsWith(folder, absl::StrCat(common, "/"));
    });
  };
  while (!common.empty() && !has_all()) common = Parent(common);
  return common;
}

// The longest common beginning and end of `folders`, two or more.
std::pair<std::string, std::string> CommonEnds(const std::vector<std::string>& folders) {
  size_t begin = 0;
  size_t end = 0;
  const std::string& first = folders[0];
  const size_t shortest = std::min_element(folders.begin(), folders.end(), [](const auto& a, const auto& b) {
                            return a.size() < b.size();
                          })->size();
  const auto all_have = [&](const auto& character) {
    return std::all_of(folders.begin(), folders.end(),
                       [&](const std::string& folder) { return character(folder) == character(first); });
  };
  while (begin < shortest && all_have([&](const std::string& folder) { return folder[begin]; })) ++begin;
  while (end < shortest - begin &&
         all_have([&](const std::string& folder) { return folder[folder.size() - 1 - end]; })) {
    ++end;
  }
  return {first.substr(0, begin), first.substr(first.size() - end)};
}

// A name for `folders` that does not match any of `others`.
std::string NameFolders(const std::vector<std::string>& folders, const std::vector<std::string>& others) {
  const auto fits_no_other = [&](const auto& fits) { return std::none_of(others.begin(), others.end(), fits); };
  const std::string common = CommonFolder(folders);
  if (!common.empty() && fits_no_other([&](const std::string& other) {
        return other == common || absl::StartsWith(other, absl::StrCat(common, "/"));
      })) {
    return common;
  }
  if (folders.size() == 1) return folders[0];
  const auto [begin, end] = CommonEnds(folders);
  if (fits_no_other([&, &begin = begin, &end = end](const std::string& other) {
        return other.size() >= begin.size() + end.size() && absl::StartsWith(other, begin) &&
               absl::EndsWith(other, end);
      })) {
    return absl::StrCat(begin, "*", end);
  }
  return absl::StrCat(folders[0], " and ", folders.size() - 1, " more");
}

void AddSettings(const google::protobuf::Message& message, const std::string& prefix, Settings* settings) {
  std::vector<const google::protobuf::FieldDescriptor*> fields;
  message.GetReflection()->ListFields(message, &fields);
  for (const google::protobuf::FieldDescriptor* field : fields) {
    const std::string name = absl::StrCat(prefix, field->name());
    if (field->cpp_type() == google::protobuf::FieldDescriptor::CPPTYPE_MESSAGE) {
      AddSettings(message.GetReflection()->GetMessage(message, field), absl::StrCat(name, "."), settings);
      continue;
    }
    google::protobuf::TextFormat::PrintFieldValueToString(message, field, -1, &(*settings)[name]);
  }
}

// The settings that may distinguish groups, without the agent. Network settings only if they were given; the others
// follow from the agent.
Settings SettingsOf(const v1::RunConfig& config) {
  v1::RunConfig shaping = ShapingConfig(config);
  *shaping.mutable_network() = config.network();
  shaping.clear_agent();
  // Trained and evaluated on the same environment: env.name is enough.
  if (shaping.eval().env() == shaping.env().name()) shaping.clear_eval();
  Settings settings;
  AddSettings(shaping, "", &settings);
  return settings;
}

Settings DefaultsOf(const v1::RunConfig& config) {
  v1::RunConfig given;
  given.set_agent(config.agent());
  v1::RunConfig defaults = ResolveRunConfig(given).value_or(config);
  // The default of fragment_steps follows from these.
  given.set_lanes(config.lanes());
  given.mutable_ppo()->set_rollout_steps(config.ppo().rollout_steps());
  defaults.set_fragment_steps(ResolveRunConfig(given).value_or(config).fragment_steps());
  return SettingsOf(defaults);
}

// "gamma=0.9", "env=crafter:numbers=easy-x2", "eval.env=crafter"
std::string SettingText(const std::string& name, std::string value) {
  value.erase(std::remove(value.begin(), value.end(), '"'), value.end());
  if (name == "env.name") return absl::StrCat("env=", value);
  return absl::StrCat(absl::StartsWith(name, "ppo.") ? name.substr(4) : name, "=", value);
}

// The number of groups with each value of each setting.
using Counts = std::map<std::string, std::map<std::string, size_t>>;

// The settings of the group that are neither the agent's default nor shared by most groups.
std::string Details(const v1::RunConfig& config, const Settings& settings, const Counts& counts, size_t groups) {
  const Settings defaults = DefaultsOf(config);
  std::vector<std::string> shown;
  for (const auto& [name, value] : settings) {
    const auto standard = defaults.find(name);
    const bool is_default = standard != defaults.end() && standard->second == value;
    const bool is_usual = name != kTextures && 2 * counts.at(name).at(value) > groups;
    if (!is_default && !is_usual) shown.push_back(SettingText(name, value));
  }
  if (shown.size() > kShownSettings) {
    const size_t more = shown.size() - kShownSettings;
    shown.resize(kShownSettings);
    shown.push_back(absl::StrCat(more, " more"));
  }
  shown.insert(shown.begin(), config.agent());
  return absl::StrJoin(shown, ", ");
}

}  // namespace

std::vector<RunName> NameGroups(absl::Span<const RunGroup* const> groups) {
  std::vector<std::string> folders;
  std::vector<Settings> settings;
  for (const RunGroup* group : groups) {
    std::vector<std::string> others;
    for (const RunGroup* other : groups) {
      if (other == group) continue;
      const std::vector<std::string> theirs = FoldersOf(*other);
      others.insert(others.end(), theirs.begin(), theirs.end());
    }
    folders.push_back(NameFolders(FoldersOf(*group), others));
    const RunRecord& first = FirstRun(*group);
    settings.push_back(SettingsOf(first.config));
    if (!first.texture_digest.empty() && first.texture_digest != kBuiltInTextures) {
      settings.back()[kTextures] = first.texture_digest;
    }
  }
  const std::vector<std::string> short_names = ShortNames(folders);
  Counts counts;
  for (const Settings& of_group : settings) {
    for (const auto& [name, value] : of_group) ++counts[name][value];
  }
  std::vector<RunName> names;
  for (size_t i = 0; i < groups.size(); ++i) {
    const std::string details = Details(FirstRun(*groups[i]).config, settings[i], counts, groups.size());
    names.push_back({folders[i], absl::StrCat(short_names[i], " (", details, ")")});
  }
  return names;
}

}  // namespace craftfleet
