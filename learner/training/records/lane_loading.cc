#include "learner/training/records/lane_loading.h"

#include <algorithm>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/io/snapshot_envelope.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

using Floats = google::protobuf::RepeatedField<float>;

absl::StatusOr<LaneSnapshot> LoadSnapshot(const std::string& game, const Floats& state,
                                          const wire::FragmentShape& shape) {
  if (state.size() != shape.state_size) {
    return absl::InvalidArgumentError(
        absl::StrFormat("the recurrent state has %d numbers, want %d", state.size(), shape.state_size));
  }
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckStates("recurrent state", state, shape.hidden, shape.max_length));
  CRAFTFLEET_RETURN_IF_ERROR(CheckSnapshot(shape.env_digest, game));
  return LaneSnapshot{game, {state.begin(), state.end()}};
}

}  // namespace

LoadedLanes LoadLanes(const v1::CheckpointState& state, const wire::FragmentShape& shape) {
  const LaneSnapshot begin = {"", std::vector<float>(shape.state_size)};
  LoadedLanes lanes;
  lanes.records.assign(shape.lanes, {0, begin, begin, ""});
  for (int i = 0; i < std::min(shape.lanes, state.lanes_size()); ++i) {
    const v1::LaneState& lane = state.lanes(i);
    LaneRecord& record = lanes.records[i];
    record.next_fragment = lane.next_fragment();
    record.previous = LoadSnapshot(lane.previous_snapshot(), lane.previous_state(), shape).value_or(begin);
    absl::StatusOr<LaneSnapshot> snapshot = LoadSnapshot(lane.snapshot(), lane.state(), shape);
    if (snapshot.ok()) {
      record.snapshot = *std::move(snapshot);
      continue;
    }
    LogError("the checkpoint's lane %d: %s; it resumes %s", i, snapshot.status().message(),
             record.previous->game.empty() ? "with a new game" : "from the snapshot before its last fragment");
    record.snapshot = std::exchange(record.previous, begin);
    ++lanes.resets;
  }
  return lanes;
}

v1::LaneState ToProto(const LaneRecord& record) {
  v1::LaneState message;
  message.set_next_fragment(record.next_fragment);
  message.set_snapshot(record.snapshot->game);
  message.mutable_state()->Assign(record.snapshot->state.begin(), record.snapshot->state.end());
  message.set_previous_snapshot(record.previous->game);
  message.mutable_previous_state()->Assign(record.previous->state.begin(), record.previous->state.end());
  return message;
}

}  // namespace craftfleet
