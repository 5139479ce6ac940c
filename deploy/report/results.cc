#include "deploy/report/results.h"

#include <algorithm>
#include <set>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>

#include "deploy/experiment/run_identity.h"

namespace craftfleet {
namespace {

constexpr char kOther[] = "other";

std::string LabelOf(const Experiment& experiment, const Cell& cell) {
  std::vector<std::string> labels;
  for (size_t i = 0; i < cell.axes.size(); ++i) {
    labels.push_back(experiment.axes[cell.axes[i]].choices[cell.choices[i]].label());
  }
  if (labels.empty()) return experiment.title;
  const bool one_of_several = experiment.combine == v1::Experiment::EACH && experiment.axes.size() > 1;
  return absl::StrCat(one_of_several ? absl::StrCat(experiment.axes[cell.axes[0]].name, " ") : "",
                      absl::StrJoin(labels, ", "));
}

// The folder that the first run of the group lies in, or the run's own where that has no name.
std::string FolderOf(const RunGroup& group) {
  const RunRecord& run = *(group.complete.empty() ? group.incomplete : group.complete).front();
  const size_t slash = run.folder.find_last_of('/');
  return slash == std::string::npos || slash == 0 ? run.folder : run.folder.substr(0, slash);
}

ExperimentResult OtherRuns(const std::map<std::string, RunGroup>& groups, const std::set<std::string>& matched) {
  ExperimentResult other = {kOther, "Runs of other configurations", v1::Experiment::EACH, {{"runs", {}}}, {}, {}};
  for (const auto& [identity, group] : groups) {
    if (matched.count(identity) > 0) continue;
    const std::string folder = FolderOf(group);
    const RunRecord& run = *(group.complete.empty() ? group.incomplete : group.complete).front();
    const int number = static_cast<int>(other.cells.size());
    const std::string label = absl::StrCat(folder.substr(folder.find_last_of('/') + 1), " (", run.config.agent(), ")");
    other.cells.push_back({folder, label, {0}, {number}, &group});
    v1::Choice choice;
    choice.set_name(folder);
    choice.set_label(label);
    other.axes[0].choices.push_back(choice);
  }
  return other;
}

}  // namespace

bool ExperimentResult::has_runs() const {
  return std::any_of(cells.begin(), cells.end(), [](const CellResult& cell) { return cell.group != nullptr; });
}

std::vector<ExperimentResult> MatchRuns(absl::Span<const Experiment> experiments,
                                        const std::map<std::string, RunGroup>& groups) {
  std::vector<ExperimentResult> results;
  std::set<std::string> matched;
  for (const Experiment& experiment : experiments) {
    ExperimentResult result = {experiment.name, experiment.title,      experiment.combine,
                               experiment.axes, experiment.milestones, {}};
    for (const Cell& cell : experiment.cells) {
      const auto group = groups.find(RunIdentity(cell.config));
      if (group != groups.end()) matched.insert(group->first);
      result.cells.push_back({cell.name, LabelOf(experiment, cell), cell.axes, cell.choices,
                              group == groups.end() ? nullptr : &group->second});
    }
    results.push_back(std::move(result));
  }
  if (ExperimentResult other = OtherRuns(groups, matched); !other.cells.empty()) results.push_back(std::move(other));
  return results;
}

std::map<std::string, std::string> CellNames(absl::Span<const Experiment> experiments) {
  std::map<std::string, std::string> names;
  for (const Experiment& experiment : experiments) {
    for (const Cell& cell : experiment.cells) {
      std::string& cells = names[RunIdentity(cell.config)];
      absl::StrAppend(&cells, cells.empty() ? "" : " ", experiment.name, "/", cell.name);
    }
  }
  return names;
}

}  // namespace craftfleet
