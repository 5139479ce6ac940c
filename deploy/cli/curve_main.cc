// craftfleet curve: draws learning curves.

#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/functional/function_ref.h>
#include <absl/strings/ascii.h>
#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/io/output_file.h"
#include "common/process/program.h"
#include "common/telemetry/log.h"
#include "deploy/cli/plot/curve_chart.h"

ABSL_FLAG(std::string, out, "", "PNG file for the picture; -: standard output [none: only print the table]");
ABSL_FLAG(std::vector<std::string>, reference, {},
          "CSV files with runs of other programs to compare with, joined by commas\n"
          "columns: episodes, steps, ep_rew_mean100 and crafter_score_cum");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet curve";
constexpr char kUsage[] =
    R"(craftfleet curve RUN... draws the learning curves of runs and prints their last values. RUN is a run folder or its
stats.jsonl, gzipped or plain. The picture shows the mean reward of the last 100 episodes on the left, and the Crafter score
over all training episodes so far on the right, against the environment steps of finished episodes.

  craftfleet curve --out=curve.png runs/first runs/second
  craftfleet curve --out=curve.png --reference=paper.csv deploy/experiments/results/ppo_cnn_300k/seed*)";

// Those that can be read; the others are named in warnings. The first error if none can.
absl::StatusOr<std::vector<NamedCurve>> ReadCurves(
    const std::vector<std::string>& paths, absl::FunctionRef<absl::StatusOr<LearningCurve>(const std::string&)> read) {
  const std::vector<std::string> names = ShortNames(paths);
  std::vector<NamedCurve> curves;
  std::vector<absl::Status> errors;
  for (size_t i = 0; i < paths.size(); ++i) {
    absl::StatusOr<LearningCurve> curve = read(paths[i]);
    if (curve.ok()) {
      curves.push_back({names[i], *std::move(curve)});
    } else {
      errors.push_back(curve.status());
    }
  }
  if (curves.empty() && !errors.empty()) return errors.front();
  for (const absl::Status& error : errors) LogWarning("left out: %s", error.message());
  return curves;
}

// The opened target of --out; nullopt without --out.
absl::StatusOr<std::optional<OutputFile>> OpenOut() {
  const std::string path = absl::GetFlag(FLAGS_out);
  if (path.empty()) return std::nullopt;
  const std::string extension = absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  if (!extension.empty() && extension != ".png") {
    return absl::InvalidArgumentError(absl::StrCat("--out=", path, ", want a file that ends in .png"));
  }
  return OutputFile::Open("--out", path);
}

absl::Status Run(const std::vector<std::string>& arguments) {
  if (arguments.empty()) return absl::InvalidArgumentError("name at least one run folder; see --help");
  CRAFTFLEET_ASSIGN_OR_RETURN(std::optional<OutputFile> out, OpenOut());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<NamedCurve> runs, ReadCurves(arguments, ReadRunCurve));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<NamedCurve> references,
                              ReadCurves(absl::GetFlag(FLAGS_reference), ReadReferenceCurve));
  const bool picture_on_stdout = out.has_value() && out->is_standard_output();
  std::fputs(CurveTable(runs, references).c_str(), picture_on_stdout ? stderr : stdout);
  return out.has_value() ? out->Write(DrawChart(CurvePanels(runs, references), {})) : absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const std::vector<std::string> arguments =
      craftfleet::ParseFlagsAndArguments(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run(arguments));
}
