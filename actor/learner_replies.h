// Checks the replies of a learner: the ranges of all fields, in one place.

#pragma once

#include <cstdint>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/base/types.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet {

// All checks return InvalidArgument with field, value and what was expected.

// Also resolves and checks the configuration.
absl::Status CheckJoinReply(v1::JoinReply* reply);

// Checks the reply to `request` in a run with `lanes` lanes. `frame_size`: of the agent, in pixels.
absl::Status CheckPermitReply(const v1::PermitRequest& request, int lanes, int frame_size,
                              const v1::PermitReply& reply);

// Checks the next chunk of weights, which may have `max_bytes` in all (MaxWeightsBytes of the run's agent). `version`
// (-1: this is the first chunk) and `total_bytes` are those of the earlier chunks, and `received` is the number of
// bytes in them.
absl::Status CheckWeightsChunk(const v1::WeightsChunk& chunk, int64_t max_bytes, int64_t version, int64_t total_bytes,
                               int64_t received);

// Returns a lane's snapshot. Only the size of its game is checked here; environment servers check its content.
absl::StatusOr<LaneSnapshot> ReadSnapshot(v1::SnapshotReply* reply, int state_size);

}  // namespace craftfleet
