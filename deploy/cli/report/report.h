// A report on a set of runs, as files in one folder.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_REPORT_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_REPORT_H_

#include <map>
#include <string>

#include <absl/types/span.h>

#include "deploy/cli/report/paper_figures.h"
#include "deploy/cli/report/run_record.h"
#include "deploy/cli/sweep/experiments.h"

namespace craftfleet {

struct Report {
  // Contents by file name: report.md, which shows the pictures; EXPERIMENT.csv for each experiment; other.csv for runs
  // that belong to none; runs.csv, achievements.csv, curves.csv; PNG files.
  std::map<std::string, std::string> files;
  int complete = 0;  // runs that have reached their number of steps
};

Report MakeReport(absl::Span<const Experiment> experiments, const PaperFigures& paper,
                  absl::Span<const RunRecord> runs);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_REPORT_H_
