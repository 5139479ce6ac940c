// The lanes of a checkpoint's state: whatever a checkpoint holds, a run has all its lanes afterwards, each with
// snapshots that pass the checks of the wire, and they load unchanged once they are stored again.

#include <cmath>

#include "common/base/check.h"
#include "common/io/snapshot_envelope.h"
#include "learner/training/records/lane_loading.h"
#include "tests/fakes/wire_samples.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

void CheckLoaded(const LaneSnapshot& snapshot) {
  CRAFTFLEET_CHECK(CheckSnapshot(kSampleShape.env_digest, snapshot.game).ok());
  CRAFTFLEET_CHECK(static_cast<int>(snapshot.state.size()) == kSampleShape.state_size);
  for (const float value : snapshot.state) CRAFTFLEET_CHECK(std::isfinite(value));
}

v1::CheckpointState ToState(const LoadedLanes& lanes) {
  v1::CheckpointState state;
  for (const LaneRecord& record : lanes.records) *state.add_lanes() = ToProto(record);
  return state;
}

v1::LaneState SampleLane(const std::string& game, const std::string& previous) {
  v1::LaneState lane;
  lane.set_next_fragment(7);
  lane.set_snapshot(game);
  lane.set_previous_snapshot(previous);
  for (int i = 0; i < kSampleShape.state_size; ++i) {
    lane.add_state(0.5F);
    lane.add_previous_state(-0.5F);
  }
  return lane;
}

}  // namespace

void TryInput(absl::string_view input) {
  v1::CheckpointState state;
  if (!state.ParseFromArray(input.data(), static_cast<int>(input.size()))) return;
  const LoadedLanes lanes = LoadLanes(state, kSampleShape);
  CRAFTFLEET_CHECK(static_cast<int>(lanes.records.size()) == kSampleShape.lanes);
  CRAFTFLEET_CHECK(lanes.resets >= 0 && lanes.resets <= kSampleShape.lanes);
  for (const LaneRecord& record : lanes.records) {
    CheckLoaded(*record.snapshot);
    CheckLoaded(*record.previous);
  }
  const v1::CheckpointState stored = ToState(lanes);
  const LoadedLanes again = LoadLanes(stored, kSampleShape);
  CRAFTFLEET_CHECK(again.resets == 0);
  CRAFTFLEET_CHECK(ToState(again).SerializeAsString() == stored.SerializeAsString());
}

std::vector<std::string> SoundInputs() {
  const std::string game = SampleSnapshot("a game");
  v1::CheckpointState sound;
  for (int lane = 0; lane < kSampleShape.lanes; ++lane) *sound.add_lanes() = SampleLane(game, game);
  v1::CheckpointState damaged;
  *damaged.add_lanes() = SampleLane(game.substr(1), game);                    // without an envelope
  *damaged.add_lanes() = SampleLane(game.substr(0, game.size() - 1), game);   // cut off
  *damaged.add_lanes() = SampleLane(SealSnapshot(1, "of another game"), "");  // and no earlier snapshot
  damaged.mutable_lanes(1)->clear_previous_state();
  v1::CheckpointState states;
  *states.add_lanes() = SampleLane(game, game);
  states.mutable_lanes(0)->set_state(0, std::nanf(""));
  *states.add_lanes() = SampleLane(game, game);
  states.mutable_lanes(1)->add_state(1);
  return {sound.SerializeAsString(), damaged.SerializeAsString(), states.SerializeAsString(), ""};
}

}  // namespace craftfleet
