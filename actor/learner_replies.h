// What a learner may answer: each field of its replies with its range, in one place.

#ifndef CRAFTFLEET_ACTOR_LEARNER_REPLIES_H_
#define CRAFTFLEET_ACTOR_LEARNER_REPLIES_H_

#include <cstdint>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/types.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet {

// All of these give DataLoss with field, value and what was expected.

// Largest file of weights, bytes: far beyond the largest agent, well below what a host would miss.
inline constexpr int64_t kMaxWeightsBytes = int64_t{2} << 30;

// Resolves and checks the configuration, too.
absl::Status CheckJoinReply(v1::JoinReply* reply);

// Of a run with `lanes` lanes, to `request`, whose active permits and capacity bound what can be granted.
absl::Status CheckPermitReply(const v1::PermitRequest& request, int lanes, int frame_size,
                              const v1::PermitReply& reply);

// The next chunk after those of `version` (-1: it is the first) that announced `total_bytes` and brought `received`.
absl::Status CheckWeightsChunk(const v1::WeightsChunk& chunk, int64_t version, int64_t total_bytes, int64_t received);

// Where a lane stands. Its game is bounded here and judged by those who play it.
absl::StatusOr<LaneSnapshot> ReadSnapshot(v1::SnapshotReply* reply, int state_size);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_LEARNER_REPLIES_H_
