// The report as a web page.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_WEB_PAGE_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_WEB_PAGE_H_

#include <string>

#include <absl/types/span.h>

#include "deploy/cli/report/run_record.h"

namespace craftfleet {

// One HTML file that needs nothing else: a leaderboard of `runs`, their curves and success rates (learner/page). Runs
// are named by their folders without the part that all have in common.
std::string WebPage(absl::Span<const RunRecord> runs);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_WEB_PAGE_H_
