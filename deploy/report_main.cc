// craftfleet report: makes the paper's tables and figures from runs.

#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>

#include "common/files.h"
#include "common/paths.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "deploy/experiment/experiments.h"
#include "deploy/report/paper_figures.h"
#include "deploy/report/report.h"
#include "deploy/report/run_record.h"

ABSL_FLAG(std::string, out, "", "folder for the report: report.md, CSV files, pictures (needed)");
ABSL_FLAG(std::string, experiments, "", "file with the experiments whose tables are made [those of the paper]");
ABSL_FLAG(std::string, figures, "", "CSV file with published figures to stand beside ours [the paper's]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet report";
constexpr char kUsage[] =
    R"(craftfleet report DIR... makes the paper's tables from the runs in or below some folders: mean and standard deviation over
seeds beside the paper's, success rates, learning curves with their spread, heatmaps; as Markdown, CSV and PNG. A run is a
folder with config.txt and stats.jsonl; which cell it belongs to follows from its configuration. Cells without a run say so,
runs that have not reached their steps are named and not averaged.

  craftfleet report runs/paper --out=report
  craftfleet report deploy/experiments/results --out=deploy/experiments/report)";

absl::StatusOr<std::string> FileOr(const std::string& given, const char* installed) {
  return given.empty() ? InstalledPath(installed) : given;
}

absl::Status Run(const std::vector<std::string>& folders) {
  if (folders.empty()) return absl::InvalidArgumentError("name at least one folder with runs; see --help");
  const std::string out = absl::GetFlag(FLAGS_out);
  if (out.empty()) return absl::InvalidArgumentError("--out is missing: the folder for the report");
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string experiments_path,
                              FileOr(absl::GetFlag(FLAGS_experiments), "experiments/paper.txt"));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Experiment> experiments, LoadExperiments(experiments_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string figures_path,
                              FileOr(absl::GetFlag(FLAGS_figures), "experiments/paper_figures.csv"));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string figures, ReadFile(figures_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const PaperFigures paper, PaperFigures::Parse(figures, figures_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<RunRecord> runs, FindRuns(folders));
  const Report report = MakeReport(experiments, paper, runs);
  CRAFTFLEET_RETURN_IF_ERROR(WriteReport(report, out));
  absl::PrintF("%d runs, %d complete; %d files in %s, begin with report.md\n", runs.size(), report.complete,
               report.files.size(), out);
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const std::vector<std::string> arguments =
      craftfleet::ParseFlagsAndArguments(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run(arguments));
}
