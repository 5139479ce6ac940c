// The numbers of the report as CSV, with all digits.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_CSV_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_CSV_H_

#include <map>
#include <string>

#include <absl/types/span.h>

#include "deploy/cli/report/paper_figures.h"
#include "deploy/cli/report/results.h"

namespace craftfleet {

// experiment,cell,measure,at,n,mean,std,paper_mean,paper_std: a line for each cell and measure, with empty numbers for
// cells without a run; and a line of `train` for each milestone.
std::string ExperimentCsv(const ExperimentResult& experiment, const PaperFigures& paper);

// experiment,cell,achievement,n,mean,std: success rates of training episodes in percent, for cells with complete runs.
std::string AchievementsCsv(absl::Span<const ExperimentResult> experiments);

// experiment,cell,steps,n,score_mean,score_std,reward_mean,reward_std: learning curves of complete runs.
std::string CurvesCsv(absl::Span<const ExperimentResult> experiments);

// folder,cells,agent,env,eval_env,seed,steps,reached,complete, then the measures: a line for each run.
// `cells`: as CellNames gives them.
std::string RunsCsv(absl::Span<const RunRecord> runs, const std::map<std::string, std::string>& cells);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_CSV_H_
