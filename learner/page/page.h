// The web page of a run: one HTML file with its style, scripts and charts (Chart.js) inside. The learner serves it
// (learner/page/live_page.h).

#pragma once

#include <absl/strings/string_view.h>

namespace craftfleet {

// The page without data: it polls the server that it came from.
absl::string_view PageTemplate();

}  // namespace craftfleet
