#include "actor/learner_replies.h"

#include <functional>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/clock.h"
#include "common/base/seeds.h"
#include "common/config/config.h"
#include "common/io/snapshot_envelope.h"
#include "learner/scheduling/evaluation_table.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// `field` is named in the error.
auto IsInvalid(const char* field) { return StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(field)); }

// Beyond the ends of the fields' types, which field_edges_test tries.
TEST(LearnerReplies, JoinIsChecked) {
  const auto check = [](const std::function<void(v1::JoinReply*)>& change) {
    v1::JoinReply reply;
    reply.set_run_id("run-a");
    reply.set_epoch(1);
    reply.set_lease_ms(5000);
    *reply.mutable_config() = DefaultRunConfig();
    change(&reply);
    const absl::Status status = CheckJoinReply(&reply);
    EXPECT_TRUE(!status.ok() || reply.config().fragment_steps() > 0) << "resolved";
    return status;
  };
  EXPECT_THAT(check([](auto*) {}), IsOk());
  EXPECT_THAT(check([](auto* reply) { reply->clear_run_id(); }), IsInvalid("run_id"));
  EXPECT_THAT(check([](auto* reply) { reply->set_lease_ms(0); }), IsInvalid("lease_ms"));
  EXPECT_THAT(check([](auto* reply) { reply->mutable_config()->set_lanes(-4); }), IsInvalid("lanes"));
  EXPECT_THAT(check([](auto* reply) { reply->mutable_config()->set_agent("none"); }), IsInvalid("config: "));
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
  EXPECT_THAT(CheckGrant(4, 0, 0, 1, 4), IsInvalid("lane"));
  EXPECT_THAT(CheckGrant(1, 0, 0, 2, 4), IsInvalid("granted"));
  EXPECT_THAT(CheckGrant(1, 0, 0, 1, 0), IsInvalid("granted"));
  v1::PermitReply reply;
  reply.add_env_servers("nowhere");
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsInvalid("env_servers"));
  reply.Clear();
  reply.add_lost();
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsInvalid("lost"));
  reply.Clear();
  reply.mutable_evaluation()->set_id(1);
  reply.mutable_evaluation()->set_first_episode(1);
  reply.mutable_evaluation()->set_episodes(2);
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsInvalid("frame_size"));
  reply.mutable_evaluation()->mutable_env()->set_frame_size(64);
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsOk());
  reply.mutable_evaluation()->set_seed(std::numeric_limits<int32_t>::max());
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsOk());
  reply.mutable_evaluation()->set_seed(int64_t{1} << 31);
  EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsInvalid("evaluation.seed"));
}

// The largest evaluations, wherever they begin, consist of tasks that an actor accepts. It used to refuse episodes
// beyond 10,000, which ended every actor.
TEST(LearnerReplies, TasksOfLateEvaluationsAreAccepted) {
  RealClock clock;
  for (const int64_t first : {int64_t{1}, int64_t{9'998}, kLastEvaluationEpisode - 2 * kMaxEvaluationEpisodes + 1}) {
    EvaluationTable scheduler(&clock);
    Evaluation evaluation;
    evaluation.number = 1;
    evaluation.first_episode = first;
    evaluation.episodes = kMaxEvaluationEpisodes;
    scheduler.Add(evaluation);
    for (const char* actor : {"plays argmax episodes", "plays sampled episodes"}) {
      const auto task = scheduler.Take(actor, absl::Minutes(1));
      ASSERT_TRUE(task.has_value());
      v1::PermitReply reply;
      reply.mutable_evaluation()->set_id(task->id);
      reply.mutable_evaluation()->set_first_episode(task->first_episode);
      reply.mutable_evaluation()->set_episodes(task->episodes);
      reply.mutable_evaluation()->mutable_env()->set_frame_size(64);
      EXPECT_THAT(CheckPermitReply({}, 4, 64, reply), IsOk()) << "from episode " << task->first_episode;
    }
  }
}

TEST(LearnerReplies, WeightsAreBounded) {
  v1::WeightsChunk chunk;
  chunk.set_policy_version(3);
  chunk.set_total_bytes(10);
  chunk.set_data("12345");
  EXPECT_THAT(CheckWeightsChunk(chunk, 10, -1, 0, 0), IsOk());
  EXPECT_THAT(CheckWeightsChunk(chunk, 10, 3, 10, 5), IsOk());
  EXPECT_THAT(CheckWeightsChunk(chunk, 10, 3, 10, 6), IsInvalid("data"));
  EXPECT_THAT(CheckWeightsChunk(chunk, 10, 2, 10, 5), IsInvalid("policy_version"));
  EXPECT_THAT(CheckWeightsChunk(chunk, 10, 3, 11, 5), IsInvalid("total_bytes"));
  chunk.set_total_bytes(11);
  EXPECT_THAT(CheckWeightsChunk(chunk, 10, -1, 0, 0), IsInvalid("total_bytes"));
  chunk.set_total_bytes(0);
  EXPECT_THAT(CheckWeightsChunk(chunk, 10, -1, 0, 0), IsInvalid("total_bytes"));
}

TEST(LearnerReplies, SnapshotsAreBoundedAndTheirStatesFinite) {
  v1::SnapshotReply reply;
  reply.set_snapshot(std::string(kMaxSnapshotBytes + 1, 'x'));
  EXPECT_THAT(ReadSnapshot(&reply, 0), IsInvalid("snapshot"));
  reply.set_snapshot("game");
  EXPECT_EQ(ReadSnapshot(&reply, 0)->game, "game");
  reply.add_state(1);
  EXPECT_THAT(ReadSnapshot(&reply, 2), IsInvalid("state"));
  reply.add_state(std::numeric_limits<float>::infinity());
  EXPECT_THAT(ReadSnapshot(&reply, 2), IsInvalid("state"));
}

}  // namespace
}  // namespace craftfleet
