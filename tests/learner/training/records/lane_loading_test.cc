#include "learner/training/records/lane_loading.h"

#include <cmath>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/snapshot_envelope.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

const LaneSnapshot kNewGame = {"", {0, 0}};

// A state with three lanes; tests modify the second.
v1::CheckpointState State() {
  v1::CheckpointState state;
  for (int i = 0; i < kSampleShape.lanes; ++i) {
    *state.add_lanes() = ToProto({5, {SampleSnapshot("five"), {0.5F, 50}}, {SampleSnapshot("four"), {0.25F, 40}}, "a"});
  }
  return state;
}

LaneRecord Load(const v1::CheckpointState& state, int resets) {
  LoadedLanes lanes = LoadLanes(state, kSampleShape);
  EXPECT_EQ(lanes.resets, resets);
  EXPECT_EQ(lanes.records.size(), kSampleShape.lanes);
  EXPECT_EQ(lanes.records[0].snapshot->game, SampleSnapshot("five"));
  return lanes.records[1];
}

TEST(LaneLoading, LoadsLanesUnchanged) {
  const LaneRecord record = Load(State(), 0);
  EXPECT_EQ(record.next_fragment, 5);
  EXPECT_EQ(record.snapshot, (LaneSnapshot{SampleSnapshot("five"), {0.5F, 50}}));
  EXPECT_EQ(record.previous, (LaneSnapshot{SampleSnapshot("four"), {0.25F, 40}}));
}

TEST(LaneLoading, MakesNewLanesWithoutACheckpoint) {
  for (const LaneRecord& record : LoadLanes({}, kSampleShape).records) {
    EXPECT_EQ(record.next_fragment, 0);
    EXPECT_EQ(record.snapshot, kNewGame);
    EXPECT_EQ(record.previous, kNewGame);
  }
}

TEST(LaneLoading, UsesThePreviousSnapshotIfTheLastIsInvalid) {
  std::string damaged = SampleSnapshot("five");
  damaged.back() = 'E';
  for (const std::string& bad : {std::string(80 << 20, 's'), damaged, std::string("no envelope"),
                                 SealSnapshot(kSampleShape.env_digest + 1, "five")}) {
    v1::CheckpointState state = State();
    state.mutable_lanes(1)->set_snapshot(bad);
    testing::internal::CaptureStderr();
    const LaneRecord record = Load(state, 1);
    EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("the checkpoint's lane 1: snapshot: "));
    EXPECT_EQ(record.next_fragment, 5) << "the fragment numbers do not change, although the game is an earlier one";
    EXPECT_EQ(record.snapshot, (LaneSnapshot{SampleSnapshot("four"), {0.25F, 40}}));
    EXPECT_EQ(record.previous, kNewGame);
    state.mutable_lanes(1)->set_previous_snapshot(bad);
    EXPECT_EQ(Load(state, 1).snapshot, kNewGame);
  }
}

TEST(LaneLoading, UsesThePreviousSnapshotIfTheRecurrentStateIsInvalid) {
  for (const float bad : {2.0F, std::nanf("")}) {
    v1::CheckpointState state = State();
    state.mutable_lanes(1)->set_state(0, bad);
    EXPECT_EQ(Load(state, 1).snapshot->game, SampleSnapshot("four"));
  }
}

}  // namespace
}  // namespace craftfleet
