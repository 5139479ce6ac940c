// craftfleet curve: draws learning curves.

#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/functional/function_ref.h>

#include "common/files.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "deploy/plot/curve_chart.h"

ABSL_FLAG(std::string, out, "", "PNG file to draw to [none: only the table is printed]");
ABSL_FLAG(std::vector<std::string>, reference, {},
          "tables of other programs' runs to draw beneath, joined by commas: CSV files with the columns\n"
          "episodes, steps, ep_rew_mean100 and crafter_score_cum");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet curve";
constexpr char kUsage[] =
    R"(craftfleet curve RUN... draws the learning curves of runs into one picture and prints where each stands. A RUN is a run's
folder or its stats.jsonl, gzipped or plain. Left: mean reward of the last 100 episodes; right: Crafter score over all
training episodes so far; both over the environment steps of finished episodes.

  craftfleet curve --out=curve.png runs/first runs/second
  craftfleet curve --out=curve.png --reference=paper.csv deploy/experiments/results/ppo_cnn_300k/seed*)";

absl::StatusOr<std::vector<NamedCurve>> ReadCurves(
    const std::vector<std::string>& paths, absl::FunctionRef<absl::StatusOr<LearningCurve>(const std::string&)> read) {
  const std::vector<std::string> names = ShortNames(paths);
  std::vector<NamedCurve> curves;
  for (size_t i = 0; i < paths.size(); ++i) {
    CRAFTFLEET_ASSIGN_OR_RETURN(LearningCurve curve, read(paths[i]));
    curves.push_back({names[i], std::move(curve)});
  }
  return curves;
}

absl::Status Run(const std::vector<std::string>& arguments) {
  if (arguments.empty()) return absl::InvalidArgumentError("name at least one run's folder; see --help");
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<NamedCurve> runs, ReadCurves(arguments, ReadRunCurve));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<NamedCurve> references,
                              ReadCurves(absl::GetFlag(FLAGS_reference), ReadReferenceCurve));
  std::fputs(CurveTable(runs, references).c_str(), stdout);
  const std::string out = absl::GetFlag(FLAGS_out);
  if (out.empty()) return absl::OkStatus();
  return ReplaceFile(out, DrawChart(CurvePanels(runs, references), {}));
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const std::vector<std::string> arguments =
      craftfleet::ParseFlagsAndArguments(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run(arguments));
}
