#include "deploy/cli/sweep/experiments.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <google/protobuf/text_format.h>

#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/config/text_format.h"
#include "common/io/files.h"
#include "deploy/cli/sweep/run_identity.h"

namespace craftfleet {
namespace {

constexpr int kMaxCells = 10'000;  // of one experiment

// Names are also names of folders.
absl::Status CheckName(absl::string_view what, absl::string_view name) {
  const bool valid = !name.empty() && name[0] != '.' && name[0] != '-' &&
                     std::all_of(name.begin(), name.end(),
                                 [](char c) { return absl::ascii_isalnum(c) || absl::StrContains("_-=.", c); });
  if (valid) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(what, " \"", name, "\": want letters, digits and any of _-=. , not beginning with . or -"));
}

template <typename Items>
absl::Status CheckNames(absl::string_view what, const Items& items) {
  std::set<std::string> names;
  for (const auto& item : items) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckName(what, item.name()));
    if (!names.insert(item.name()).second) {
      return absl::InvalidArgumentError(absl::StrCat(what, " \"", item.name(), "\" occurs twice"));
    }
  }
  return absl::OkStatus();
}

template <typename Items>
auto FindByName(const Items& items, absl::string_view name) {
  return std::find_if(items.begin(), items.end(), [name](const auto& item) { return item.name() == name; });
}

absl::StatusOr<ExperimentAxis> ResolveAxis(const v1::ExperimentFile& file, const v1::AxisUse& use) {
  const auto axis = FindByName(file.axes(), use.axis());
  if (axis == file.axes().end()) {
    return absl::InvalidArgumentError(absl::StrCat("axis \"", use.axis(), "\" is not in the file"));
  }
  ExperimentAxis resolved = {axis->name(), {axis->choices().begin(), axis->choices().end()}};
  if (use.only_size() > 0) {
    resolved.choices.clear();
    for (const std::string& name : use.only()) {
      const auto choice = FindByName(axis->choices(), name);
      if (choice == axis->choices().end()) {
        return absl::InvalidArgumentError(absl::StrCat("axis \"", use.axis(), "\" has no choice \"", name, "\""));
      }
      resolved.choices.push_back(*choice);
    }
  }
  for (v1::Choice& choice : resolved.choices) {
    if (choice.label().empty()) choice.set_label(choice.name());
  }
  return resolved;
}

// The sets of axes that are varied together.
std::vector<std::vector<int>> VariedTogether(v1::Experiment::Combine combine, int axes) {
  std::vector<std::vector<int>> sets;
  switch (combine) {
    case v1::Experiment::EACH:
      for (int a = 0; a < axes; ++a) sets.push_back({a});
      return sets;
    case v1::Experiment::PAIRS:
      for (int a = 0; a < axes; ++a) {
        for (int b = a + 1; b < axes; ++b) sets.push_back({a, b});
      }
      return sets;
    default:
      sets.emplace_back();
      for (int a = 0; a < axes; ++a) sets.back().push_back(a);
      return sets;
  }
}

absl::StatusOr<Cell> MakeCell(const v1::Experiment& description, const Experiment& experiment,
                              const std::vector<int>& axes, const std::vector<int>& choices) {
  Cell cell;
  cell.experiment = experiment.name;
  cell.axes = axes;
  cell.choices = choices;
  v1::RunConfig given = description.base();
  std::vector<std::string> names;
  for (size_t i = 0; i < axes.size(); ++i) {
    const v1::Choice& choice = experiment.axes[axes[i]].choices[choices[i]];
    given.MergeFrom(choice.config());
    if (!choice.texture_digest().empty()) cell.texture_digest = choice.texture_digest();
    names.push_back(choice.name());
  }
  cell.name = names.empty() ? experiment.name : absl::StrJoin(names, "/");
  cell.folder = absl::StrCat(experiment.name, "/", cell.name);
  google::protobuf::TextFormat::PrintToString(given, &cell.config_text);
  const auto in_cell = [&cell](const absl::Status& status) {
    return absl::InvalidArgumentError(absl::StrCat("cell \"", cell.name, "\": ", status.message()));
  };
  absl::StatusOr<v1::RunConfig> config = ParseRunConfig(cell.config_text, "configuration");
  if (config.ok()) config = ResolveRunConfig(*std::move(config));
  if (!config.ok()) return in_cell(config.status());
  if (absl::Status envs = CheckEnvs(*config); !envs.ok()) return in_cell(envs);
  cell.config = *std::move(config);
  return cell;
}

absl::Status AddCells(const v1::Experiment& description, const std::vector<int>& axes, Experiment* experiment) {
  int64_t count = 1;
  for (const int axis : axes) count *= static_cast<int64_t>(experiment->axes[axis].choices.size());
  if (count + static_cast<int64_t>(experiment->cells.size()) > kMaxCells) {
    return absl::InvalidArgumentError(absl::StrCat("more than ", kMaxCells, " cells"));
  }
  std::vector<int> choices(axes.size());
  for (int64_t number = 0; number < count; ++number) {
    int64_t rest = number;
    for (size_t i = axes.size(); i-- > 0;) {
      const auto size = static_cast<int64_t>(experiment->axes[axes[i]].choices.size());
      choices[i] = static_cast<int>(rest % size);
      rest /= size;
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(Cell cell, MakeCell(description, *experiment, axes, choices));
    experiment->cells.push_back(std::move(cell));
  }
  return absl::OkStatus();
}

absl::StatusOr<Experiment> MakeExperiment(const v1::ExperimentFile& file, const v1::Experiment& description) {
  Experiment experiment;
  experiment.name = description.name();
  experiment.title = description.title().empty() ? description.name() : description.title();
  experiment.combine = description.combine();
  experiment.milestones.assign(description.milestones().begin(), description.milestones().end());
  if (!std::is_sorted(experiment.milestones.begin(), experiment.milestones.end())) {
    return absl::InvalidArgumentError("milestones do not ascend");
  }
  for (const v1::AxisUse& use : description.axes()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(ExperimentAxis axis, ResolveAxis(file, use));
    experiment.axes.push_back(std::move(axis));
  }
  for (const auto& axes : VariedTogether(experiment.combine, static_cast<int>(experiment.axes.size()))) {
    CRAFTFLEET_RETURN_IF_ERROR(AddCells(description, axes, &experiment));
  }
  return experiment;
}

// Cells with the same configuration share the folder of the first one.
void ShareFolders(std::vector<Experiment>* experiments) {
  std::map<std::string, std::string> folders;
  for (Experiment& experiment : *experiments) {
    for (Cell& cell : experiment.cells) {
      cell.folder = folders.emplace(RunIdentity(cell.config, cell.texture_digest), cell.folder).first->second;
    }
  }
}

}  // namespace

absl::StatusOr<std::vector<Experiment>> ParseExperiments(absl::string_view text, absl::string_view filename) {
  v1::ExperimentFile file;
  CRAFTFLEET_RETURN_IF_ERROR(ParseTextFormat(text, filename, &file));
  const auto in_file = [filename](absl::string_view where, const absl::Status& status) {
    return absl::InvalidArgumentError(absl::StrCat(filename, ": ", where, status.message()));
  };
  if (absl::Status status = CheckNames("axis", file.axes()); !status.ok()) return in_file("", status);
  if (absl::Status status = CheckNames("experiment", file.experiments()); !status.ok()) return in_file("", status);
  for (const v1::Axis& axis : file.axes()) {
    const std::string where = absl::StrCat("axis \"", axis.name(), "\": ");
    if (absl::Status status = CheckNames("choice", axis.choices()); !status.ok()) return in_file(where, status);
  }
  if (file.experiments().empty()) return absl::InvalidArgumentError(absl::StrCat(filename, ": no experiment in it"));
  std::vector<Experiment> experiments;
  for (const v1::Experiment& description : file.experiments()) {
    absl::StatusOr<Experiment> experiment = MakeExperiment(file, description);
    if (!experiment.ok()) {
      return in_file(absl::StrCat("experiment \"", description.name(), "\": "), experiment.status());
    }
    experiments.push_back(*std::move(experiment));
  }
  ShareFolders(&experiments);
  return experiments;
}

absl::StatusOr<std::vector<Experiment>> LoadExperiments(const std::string& path) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return ParseExperiments(text, path);
}

}  // namespace craftfleet
