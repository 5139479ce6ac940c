// What craftfleet-learner and craftfleet train do around a run.

#pragma once

#include <functional>
#include <string>

#include <absl/status/status.h>

#include "learner/learner.h"

namespace craftfleet {

// Serves metrics at `metrics_address` unless it is empty, and calls `run`, which runs the learner. Before that, logs
// the run's id, folder and address, and the number of steps to train if it differs from --steps; once `run` has
// returned OK, how the run ended. If progress lines could not be printed, logs a warning: the run itself is unaffected.
//   Errors of `run` and ServeMetrics.   DataLoss: standard output, which receives progress lines, can't be written.
absl::Status RunWithMessages(Learner* learner, const std::string& logdir, const std::string& metrics_address,
                             const std::function<absl::Status()>& run);

}  // namespace craftfleet
