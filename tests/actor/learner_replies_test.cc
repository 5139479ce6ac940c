#include "actor/learner_replies.h"

#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config.h"
#include "common/snapshot_envelope.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

auto IsNonsense(const char* text) { return StatusIs(absl::StatusCode::kDataLoss, HasSubstr(text)); }

v1::JoinReply GoodJoin() {
  v1::JoinReply reply;
  reply.set_run_id("run-a");
  reply.set_epoch(1);
  reply.set_lease_ms(5000);
  *reply.mutable_config() = DefaultRunConfig();
  return reply;
}

TEST(LearnerReplies, JoinIsChecked) {
  v1::JoinReply reply = GoodJoin();
  EXPECT_THAT(CheckJoinReply(&reply), IsOk());
  EXPECT_GT(reply.config().fragment_steps(), 0) << "resolved";
  reply = GoodJoin();
  reply.clear_run_id();
  EXPECT_THAT(CheckJoinReply(&reply), IsNonsense("run_id is empty"));
  reply = GoodJoin();
  reply.set_epoch(-1);
  EXPECT_THAT(CheckJoinReply(&reply), IsNonsense("epoch: -1"));
  reply = GoodJoin();
  reply.set_lease_ms(0);
  EXPECT_THAT(CheckJoinReply(&reply), IsNonsense("lease_ms: 0, want 100.."));
  reply = GoodJoin();
  reply.mutable_config()->set_lanes(-4);
  EXPECT_THAT(CheckJoinReply(&reply), IsNonsense("config: lanes is -4"));
  reply = GoodJoin();
  reply.mutable_config()->set_agent("none");
  EXPECT_THAT(CheckJoinReply(&reply), IsNonsense("config: "));
}

absl::Status CheckGrant(int lane, int64_t fragment, int64_t version, int times, int capacity) {
  v1::PermitRequest request;
  request.set_capacity(capacity);
  v1::PermitReply reply;
  for (int i = 0; i < times; ++i) {
    v1::Permit* permit = reply.add_granted();
    permit->set_lane(lane + i / 2);
    permit->set_fragment(fragment);
    permit->set_policy_version(version);
  }
  return CheckPermitReply(request, /*lanes=*/4, /*frame_size=*/64, reply);
}

TEST(LearnerReplies, PermitsAreChecked) {
  EXPECT_THAT(CheckGrant(3, 0, 0, 1, 4), IsOk());
  EXPECT_THAT(CheckGrant(4, 0, 0, 1, 4), IsNonsense("granted: lane: 4, want 0..3"));
  EXPECT_THAT(CheckGrant(-1, 0, 0, 1, 4), IsNonsense("granted: lane: -1"));
  EXPECT_THAT(CheckGrant(0, -1, 0, 1, 4), IsNonsense("granted: fragment: -1"));
  EXPECT_THAT(CheckGrant(0, 0, -1, 1, 4), IsNonsense("granted: policy_version: -1"));
  EXPECT_THAT(CheckGrant(1, 0, 0, 2, 4), IsNonsense("lane 1 twice"));
  EXPECT_THAT(CheckGrant(1, 0, 0, 1, 0), IsNonsense("granted permits: 1, want 0..0"));
  v1::PermitReply reply;
  reply.add_env_servers("nowhere");
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsNonsense("\"nowhere\" is no address"));
  reply.Clear();
  reply.add_lost();
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsNonsense("lost permits: 1, want 0..0"));
  reply.Clear();
  reply.mutable_evaluation()->set_id(1);
  reply.mutable_evaluation()->set_first_episode(1);
  reply.mutable_evaluation()->set_episodes(2);
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsNonsense("frame_size: 0, want 64..64"));
  reply.mutable_evaluation()->mutable_env()->set_frame_size(64);
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsOk());
  reply.mutable_evaluation()->set_episodes(-2);
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsNonsense("episodes=-2"));
}

TEST(LearnerReplies, WeightsAreBounded) {
  v1::WeightsChunk chunk;
  chunk.set_policy_version(3);
  chunk.set_total_bytes(10);
  chunk.set_data("12345");
  EXPECT_THAT(CheckWeightsChunk(chunk, -1, 0, 0), IsOk());
  EXPECT_THAT(CheckWeightsChunk(chunk, 3, 10, 5), IsOk());
  EXPECT_THAT(CheckWeightsChunk(chunk, 3, 10, 6), IsNonsense("bytes received: 11, want 0..10"));
  EXPECT_THAT(CheckWeightsChunk(chunk, 2, 10, 5), IsNonsense("policy_version: 3, want 2..2"));
  EXPECT_THAT(CheckWeightsChunk(chunk, 3, 11, 5), IsNonsense("total_bytes: 10, want 11..11"));
  chunk.set_total_bytes(kMaxWeightsBytes + 1);
  EXPECT_THAT(CheckWeightsChunk(chunk, -1, 0, 0), IsNonsense("total_bytes"));
  chunk.set_total_bytes(0);
  EXPECT_THAT(CheckWeightsChunk(chunk, -1, 0, 0), IsNonsense("total_bytes: 0"));
}

TEST(LearnerReplies, SnapshotsAreBoundedAndTheirStatesFinite) {
  v1::SnapshotReply reply;
  reply.set_snapshot(std::string(kMaxSnapshotBytes + 1, 'x'));
  EXPECT_THAT(ReadSnapshot(&reply, 0), IsNonsense("bytes of the snapshot"));
  reply.set_snapshot("game");
  EXPECT_EQ(ReadSnapshot(&reply, 0)->game, "game");
  reply.add_state(1);
  EXPECT_THAT(ReadSnapshot(&reply, 2), IsNonsense("state: 1 numbers, want 2"));
  reply.add_state(std::numeric_limits<float>::infinity());
  EXPECT_THAT(ReadSnapshot(&reply, 2), IsNonsense("finite"));
}

}  // namespace
}  // namespace craftfleet
