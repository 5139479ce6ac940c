// Log messages of craftfleet-learner and craftfleet train at the start and end of a run.

#pragma once

#include <string>

#include <absl/status/status.h>

#include "learner/learner.h"

namespace craftfleet {

// Logs the run's id, folder and address, and the number of steps to train if it differs from --steps.
//   DataLoss: standard output, which receives progress lines, can't be written.
absl::Status LogRunStart(const Learner& learner, const std::string& logdir);

// Logs how the run ended, after Learner::Run has returned OK. If progress lines could not be printed, logs a warning:
// the run itself is unaffected.
void LogRunEnd(const Learner& learner);

}  // namespace craftfleet
