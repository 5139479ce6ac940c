// The flags of a training run, shared by craftfleet-learner and craftfleet-train.

#ifndef CRAFTFLEET_LEARNER_RUN_FLAGS_H_
#define CRAFTFLEET_LEARNER_RUN_FLAGS_H_

#include <absl/status/statusor.h>

#include "learner/learner.h"

namespace craftfleet {

// What the flags ask for: defaults, or the stored configuration with --resume; over them --config; over that the flags
// that were given. The server has no address yet. Progress goes to standard output.
//   InvalidArgument names the flag or the file and line.
absl::StatusOr<Learner::Options> LearnerOptionsFromFlags();

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_FLAGS_H_
