// craftfleet report: makes the paper's tables and figures from runs.

#include <cstdio>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/io/paths.h"
#include "common/process/program.h"
#include "common/telemetry/log.h"
#include "deploy/cli/report/paper_figures.h"
#include "deploy/cli/report/report.h"
#include "deploy/cli/report/report_target.h"
#include "deploy/cli/report/run_record.h"
#include "deploy/cli/report/web_page.h"
#include "deploy/cli/sweep/experiments.h"

ABSL_FLAG(std::string, out, "",
          "folder for the report: report.md, CSV files, pictures; -: report.md alone, on standard output (required)");
ABSL_FLAG(bool, html, false,
          "also make report.html: a leaderboard of the runs with curves, in one file for browsers that needs no other");
ABSL_FLAG(std::string, experiments, "", "file with the experiments to make tables for [those of the paper]");
ABSL_FLAG(std::string, figures, "", "CSV file with published figures to compare with [the paper's]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet report";
constexpr char kUsage[] =
    R"(craftfleet report DIR... makes the paper's tables from the runs in or below the given folders: mean and standard deviation
over seeds, compared with the paper's; success rates, learning curves with their spread, and heatmaps; as Markdown, CSV and
PNG. A run is a folder with config.txt and stats.jsonl. Its configuration determines the cell of the table. The report marks
cells without a run, and lists unfinished runs without averaging them. A run that cannot be read is named in a warning and
left out; if there is no other, the program ends with its error.

  craftfleet report runs/paper --out=report
  craftfleet report runs/paper --out=report --html
  craftfleet report deploy/experiments/results --out=deploy/experiments/report)";

absl::StatusOr<std::string> FileOr(const std::string& given, const char* installed) {
  return given.empty() ? InstalledPath(installed) : given;
}

absl::Status Run(const std::vector<std::string>& folders) {
  if (folders.empty()) return absl::InvalidArgumentError("name at least one folder with runs; see --help");
  const std::string out = absl::GetFlag(FLAGS_out);
  if (out.empty()) return absl::InvalidArgumentError("--out is missing: the folder for the report");
  CRAFTFLEET_ASSIGN_OR_RETURN(ReportTarget target, ReportTarget::Open(out));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string experiments_path,
                              FileOr(absl::GetFlag(FLAGS_experiments), "experiments/paper.txt"));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Experiment> experiments, LoadExperiments(experiments_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string figures_path,
                              FileOr(absl::GetFlag(FLAGS_figures), "experiments/paper_figures.csv"));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string figures, ReadFile(figures_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const PaperFigures paper, PaperFigures::Parse(figures, figures_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const FoundRuns found, FindRuns(folders));
  const std::vector<RunRecord>& runs = found.runs;
  if (runs.empty() && !found.unreadable.empty()) return found.unreadable.front();
  if (runs.empty()) {
    return absl::NotFoundError(absl::StrCat("no run in or below ", absl::StrJoin(folders, ", "),
                                            ", want a folder with config.txt and stats.jsonl"));
  }
  for (const absl::Status& error : found.unreadable) LogWarning("left out: %s", error.message());
  Report report = MakeReport(experiments, paper, runs);
  if (absl::GetFlag(FLAGS_html)) report.files["report.html"] = WebPage(runs);
  CRAFTFLEET_ASSIGN_OR_RETURN(const int files, target.Write(report));
  std::FILE* const people = target.is_standard_output() ? stderr : stdout;
  absl::FPrintF(people, "%d runs, %d complete; ", runs.size(), report.complete);
  if (!found.unreadable.empty()) absl::FPrintF(people, "%d more cannot be read; ", found.unreadable.size());
  if (files == 1) {
    absl::FPrintF(people, "report.md written to %s\n", target.is_standard_output() ? "standard output" : out);
  } else {
    absl::FPrintF(people, "%d files in %s, begin with report.md\n", files, out);
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const std::vector<std::string> arguments = craftfleet::ParseFlagsAndArguments(
      craftfleet::kProgram, craftfleet::kUsage, argc, argv, {"out", "html", "experiments", "figures"});
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run(arguments));
}
