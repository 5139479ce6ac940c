// Protobuf messages <-> the plain structs of common/base/types.h. Sizes are checked here; ranges in fragment_check.h,
// request_check.h and, for replies, actor/play_reply.h and learner_replies.h. Frames and snapshots are moved, not
// copied: the messages are left without them.

#pragma once

#include <cstdint>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/base/types.h"
#include "common/wire/fragment_check.h"
#include "craftfleet/v1/environment.pb.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet::wire {

v1::FragmentMessage ToProto(Fragment fragment);
// The same without frames, of which there are megabytes: the caller sets them in another format.
v1::FragmentMessage ToProtoWithoutFrames(const Fragment& fragment);

// InvalidArgument: a field of the wrong size or out of range; the message names it, the value and what was expected.
absl::StatusOr<Fragment> FromProto(v1::FragmentMessage* message, const FragmentShape& shape);

v1::SnapshotReply ToProto(LaneSnapshot snapshot);

// `state_size` as in FragmentShape. InvalidArgument: the state has another size or is not finite.
absl::StatusOr<LaneSnapshot> FromProto(v1::SnapshotReply* message, int state_size);

// Whole episodes of at most `max_length` steps; `step` of them is 0. Checked as above.
v1::EvaluationResult ToProto(const std::vector<Episode>& episodes);
absl::StatusOr<std::vector<Episode>> FromProto(const v1::EvaluationResult& message,
                                               int64_t max_length = kMaxEpisodeLength);

// `message` is reused: its buffers keep their capacity. The frames of `batch` are moved out.
void ToProto(StepBatch* batch, v1::PlayReply* message);

// The reply to a step of `lanes` lanes, whose episodes have at most `max_length` steps; checks sizes and ranges like
// FromProto above.
absl::Status FromProto(v1::PlayReply* message, int lanes, int frame_bytes, int64_t max_length, StepBatch* batch);

// The moments in a reply to a session that records episodes.
void ToProto(std::vector<Moment> moments, v1::PlayReply* message);

// The moments of a reply about `lanes` lanes, with pictures of `picture_bytes`. Checked as above.
absl::StatusOr<std::vector<Moment>> MomentsFromProto(v1::PlayReply* message, int lanes, int frame_bytes,
                                                     int picture_bytes);

// One action per lane, each 0..16. InvalidArgument otherwise.
absl::Status ActionsFromProto(const v1::StepLanes& request, std::vector<Action>* actions);

}  // namespace craftfleet::wire
