// The report of a set of runs, as files of one folder.

#ifndef CRAFTFLEET_DEPLOY_REPORT_REPORT_H_
#define CRAFTFLEET_DEPLOY_REPORT_REPORT_H_

#include <map>
#include <string>

#include <absl/status/status.h>
#include <absl/types/span.h>

#include "deploy/experiment/experiments.h"
#include "deploy/report/paper_figures.h"
#include "deploy/report/run_record.h"

namespace craftfleet {

struct Report {
  // Contents by file name: report.md, which shows the pictures; EXPERIMENT.csv for each experiment; runs.csv,
  // achievements.csv, curves.csv; PNGs.
  std::map<std::string, std::string> files;
  int complete = 0;  // runs that have reached their steps
};

Report MakeReport(absl::Span<const Experiment> experiments, const PaperFigures& paper,
                  absl::Span<const RunRecord> runs);

// Creates `folder` if need be and replaces files of these names in it.
absl::Status WriteReport(const Report& report, const std::string& folder);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_REPORT_REPORT_H_
