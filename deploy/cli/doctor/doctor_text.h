// The findings of craftfleet doctor as text and as JSON.

#ifndef CRAFTFLEET_DEPLOY_CLI_DOCTOR_DOCTOR_TEXT_H_
#define CRAFTFLEET_DEPLOY_CLI_DOCTOR_DOCTOR_TEXT_H_

#include <string>
#include <vector>

#include "deploy/cli/doctor/finding.h"

namespace craftfleet {

// A line for each finding, such as "warn  clock       ...", followed by a line with the remedy unless it is ok. With
// `colour` the verdicts are green, yellow or red, with ANSI escapes.
std::string DoctorText(const std::vector<Finding>& findings, bool colour);

// {"ok": true, "checks": [{"check": "clock", "verdict": "warn", "found": "...", "remedy": "..."}]}; "ok" is false if a
// check fails.
std::string DoctorJson(const std::vector<Finding>& findings);

// Names of the failed checks, joined by commas; empty without any.
std::string FailedChecks(const std::vector<Finding>& findings);

// Whether to print in colour. `terminal`: whether standard output is one. False if the variable NO_COLOR has a value
// (https://no-color.org) or TERM is "dumb". A null pointer is a variable that is not set.
bool WantsColour(bool terminal, const char* no_color, const char* term);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_DOCTOR_DOCTOR_TEXT_H_
