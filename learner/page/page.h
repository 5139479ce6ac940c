// The web page of runs: one HTML file with its style, scripts and charts (Chart.js) inside. The learner serves it for
// its run (learner/page/live_page.h); `craftfleet report --html` writes it with finished runs.

#ifndef CRAFTFLEET_LEARNER_PAGE_PAGE_H_
#define CRAFTFLEET_LEARNER_PAGE_PAGE_H_

#include <absl/strings/string_view.h>

namespace craftfleet {

// The page without data: it polls the server that it came from. Where the `null` in its script element "report" is
// replaced by a report, as report.js reads it, it shows that (craftfleet/analysis/web_page.py).
absl::string_view PageTemplate();

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PAGE_PAGE_H_
