#include "deploy/cli/report/results.h"

#include <algorithm>
#include <numeric>
#include <set>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>

#include "deploy/cli/report/run_names.h"
#include "deploy/cli/sweep/run_identity.h"

namespace craftfleet {
namespace {

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

// The groups that belong to no cell, as one result.
ExperimentResult OwnRuns(const std::map<std::string, RunGroup>& groups, const std::set<std::string>& matched) {
  std::vector<const RunGroup*> own;
  for (const auto& [identity, group] : groups) {
    if (matched.count(identity) == 0) own.push_back(&group);
  }
  const std::vector<RunName> names = NameGroups(own);
  std::vector<size_t> order(own.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return names[a].folder < names[b].folder; });

  ExperimentResult result = {
      ExperimentResult::kOwnRuns, "Your own configurations", v1::Experiment::EACH, {{"runs", {}}}, {}, {}};
  for (const size_t i : order) {
    const int number = static_cast<int>(result.cells.size());
    result.cells.push_back({names[i].folder, names[i].label, {0}, {number}, own[i]});
    v1::Choice choice;
    choice.set_name(names[i].folder);
    choice.set_label(names[i].label);
    result.axes[0].choices.push_back(choice);
  }
  return result;
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
      const auto group = groups.find(RunIdentity(cell.config, cell.texture_digest));
      if (group != groups.end()) matched.insert(group->first);
      result.cells.push_back({cell.name, LabelOf(experiment, cell), cell.axes, cell.choices,
                              group == groups.end() ? nullptr : &group->second});
    }
    results.push_back(std::move(result));
  }
  if (ExperimentResult own = OwnRuns(groups, matched); !own.cells.empty()) {
    results.insert(results.begin(), std::move(own));
  }
  return results;
}

std::map<std::string, std::string> CellNames(absl::Span<const Experiment> experiments) {
  std::map<std::string, std::string> names;
  for (const Experiment& experiment : experiments) {
    for (const Cell& cell : experiment.cells) {
      std::string& cells = names[RunIdentity(cell.config, cell.texture_digest)];
      absl::StrAppend(&cells, cells.empty() ? "" : " ", experiment.name, "/", cell.name);
    }
  }
  return names;
}

}  // namespace craftfleet
