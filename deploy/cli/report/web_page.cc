#include "deploy/cli/report/web_page.h"

#include <algorithm>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "learner/page/page.h"
#include "learner/run/score_curve.h"

namespace craftfleet {
namespace {

// The length of the path, with its last slash, that all folders begin with. 0 for a single run.
size_t CommonPath(absl::Span<const RunRecord> runs) {
  if (runs.size() < 2) return 0;
  std::string common = runs[0].folder;
  for (const RunRecord& run : runs) {
    const auto end = std::mismatch(common.begin(), common.end(), run.folder.begin(), run.folder.end()).first;
    common.erase(end, common.end());
  }
  const size_t slash = common.rfind('/');
  return slash == std::string::npos ? 0 : slash + 1;
}

std::vector<CurvePoint> Thinned(const LearningCurve& curve) {
  ThinnedSeries<CurvePoint> series;
  for (const CurvePoint& point : curve) series.Add(point);
  return series.Points();
}

nlohmann::json JsonOfRun(const RunRecord& run, size_t common_path) {
  nlohmann::json json = {
      {"name", run.folder.substr(common_path)},
      {"agent", run.config.agent()},
      {"env", run.config.env().name()},
      {"seed", run.config.seed()},
      {"steps", run.steps},
      {"complete", run.complete},
      {"score", run.training.score},
      {"evaluation", nullptr},
      {"reward", run.training.recent_reward},
      {"unlocked", run.training.unlocked},
      {"rates", JsonOfRates(run.training.success)},
      {"curve", JsonOfCurve(Thinned(run.curve))},
  };
  if (run.eval_sampled.episodes > 0) json["evaluation"] = run.eval_sampled.score;
  return json;
}

}  // namespace

std::string WebPage(absl::Span<const RunRecord> runs) {
  const size_t common_path = CommonPath(runs);
  nlohmann::json list = nlohmann::json::array();
  for (const RunRecord& run : runs) list.push_back(JsonOfRun(run, common_path));
  return PageOfReport({{"runs", std::move(list)}});
}

}  // namespace craftfleet
