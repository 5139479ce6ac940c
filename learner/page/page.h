// The web page of a run: one HTML file with its style, scripts and charts (Chart.js) inside. The learner serves it
// (learner/page/live_page.h).

#ifndef CRAFTFLEET_LEARNER_PAGE_PAGE_H_
#define CRAFTFLEET_LEARNER_PAGE_PAGE_H_

#include <string>
#include <vector>

#include <absl/strings/string_view.h>
#include <nlohmann/json.hpp>

#include "learner/run/score.h"
#include "learner/run/score_curve.h"

namespace craftfleet {

// The page without data: it polls the server that it came from.
absl::string_view PageTemplate();

// {"steps": [...], "reward": [...], "score": [...]}, as live.js reads it.
nlohmann::json JsonOfCurve(const std::vector<CurvePoint>& curve);
// {"collect_coal": 1.5, ...}, in percent.
nlohmann::json JsonOfRates(const AchievementPercentages& rates);

// The texts of the page's scripts that run, for a content security policy.
std::vector<absl::string_view> ScriptsOf(absl::string_view page);

// `text` compressed as gzip.
std::string Gzip(absl::string_view text);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PAGE_PAGE_H_
