// The learner's epoch: how often a learner has started on a run folder. Permits carry it, so that a fragment asked for
// by an earlier start is told from one of this start.

#ifndef CRAFTFLEET_LEARNER_RUN_EPOCH_H_
#define CRAFTFLEET_LEARNER_RUN_EPOCH_H_

#include <cstdint>
#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

// The epoch of the latest start; 0: no learner has started yet.
//   DataLoss: the file holds no number.
absl::StatusOr<int64_t> ReadEpoch(const std::string& logdir);

// One more than ReadEpoch, durable when this returns.
absl::StatusOr<int64_t> NextEpoch(const std::string& logdir);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_EPOCH_H_
