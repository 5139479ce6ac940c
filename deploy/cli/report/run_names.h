// Names for runs that belong to no cell of an experiment.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_NAMES_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_NAMES_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/report/run_group.h"

namespace craftfleet {

struct RunName {
  std::string folder;  // "runs/wide": the folder of the group's runs, unique among the groups
  std::string label;   // "wide (ppo_cnn, lanes=32)": for tables and charts
};

// A name for each of `groups`, in their order; each group has a run.
//
// The folder of a group is that of its run, or the deepest one that contains all runs of the group and no others:
// "runs/wide" for runs/wide/seed1 and runs/wide/seed2. If there is no such folder, it is a pattern such as
// "runs/wide-*", or the first run and the number of others.
//
// The label is the folder without the part that all groups have in common. The agent follows in brackets, with at most
// three settings that are neither the agent's default nor shared by more than half of the groups.
std::vector<RunName> NameGroups(absl::Span<const RunGroup* const> groups);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_NAMES_H_
