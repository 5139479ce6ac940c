#include "learner/service/learner_service.h"

#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/learner/service/learner_service_fixture.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

TEST_F(LearnerServiceTest, JoinDescribesTheRun) {
  const auto reply = Join("a");
  ASSERT_THAT(reply, IsOk());
  EXPECT_EQ(reply->run_id(), "run-a");
  EXPECT_EQ(reply->epoch(), kEpoch);
  EXPECT_EQ(reply->config().lanes(), kSampleShape.lanes);
  EXPECT_EQ(reply->texture_digest(), "digest");
  EXPECT_EQ(reply->lease_ms(), 5000);
  EXPECT_FALSE(reply->program_version().empty());
  EXPECT_THAT(Join("b", "run-a"), IsOk()) << "an actor that joins again";
}

TEST_F(LearnerServiceTest, JoinRefusesIncompatibleActors) {
  EXPECT_THAT(Join("a", "", wire::kProtocolVersion + 1),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("upgrade the learner")));
  EXPECT_THAT(Join("a", "", wire::kProtocolVersion - 1),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("upgrade the actor")));
  EXPECT_THAT(Join("a", "run-b"), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("belongs to run run-b")));
  EXPECT_THAT(Join(""), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("actor is empty")));
  EXPECT_THAT(GetPermits("a"), StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
}

TEST_F(LearnerServiceTest, AnActorReportsABoundedNumberOfServers) {
  ASSERT_THAT(Join("a"), IsOk());
  v1::PermitRequest request;
  request.set_actor("a");
  request.set_epoch(kEpoch);
  request.add_env_servers()->set_address("10.0.0.1:\x1b[2J");
  for (int i = 1; i < 100; ++i) request.add_env_servers()->set_address(absl::StrCat("10.0.0.1:", i));
  ASSERT_THAT(Ask(request), IsOk());
  v1::StatusReply status;
  service_.FillStatus(&status);
  EXPECT_EQ(status.peers_size(), 1 + 63) << "the actor, and the first 64 servers except the one without an address";
}

TEST_F(LearnerServiceTest, AServerWithImpossibleNumbersIsLeftOut) {
  ASSERT_THAT(Join("a"), IsOk());
  v1::PermitRequest request;
  request.set_actor("a");
  request.set_epoch(kEpoch);
  request.add_env_servers()->set_address("10.0.0.1:1");
  v1::Peer* const bad = request.add_env_servers();
  bad->set_address("10.0.0.1:2");
  bad->mutable_summary()->set_steps_per_second(std::nan(""));
  v1::Peer* const slow = request.add_env_servers();
  slow->set_address("10.0.0.1:3");
  slow->set_step_ms(-1);
  ASSERT_THAT(Ask(request), IsOk());
  v1::StatusReply status;
  service_.FillStatus(&status);
  ASSERT_EQ(status.peers_size(), 2) << "the actor and the first server";
  EXPECT_EQ(status.peers(1).address(), "10.0.0.1:1");
}

TEST_F(LearnerServiceTest, PermitsAreForThisEpoch) {
  ASSERT_THAT(Join("a"), IsOk());
  EXPECT_THAT(
      GetPermits("a", kEpoch - 1),
      StatusIs(absl::StatusCode::kAborted, AllOf(HasSubstr("epoch 3"), HasSubstr("epoch 4"), HasSubstr("join again"))));
}

// When an actor's process dies, its stream breaks.
TEST_F(LearnerServiceTest, ABrokenStreamShortensTheLease) {
  Enter("a");
  ASSERT_THAT(Join("b"), IsOk());
  grpc::ClientContext context;
  v1::PermitRequest request;
  request.set_actor("a");
  request.set_epoch(kEpoch);
  request.set_wait_ms(300);
  for (int lane = 0; lane < kSampleShape.lanes; ++lane) {
    v1::Permit* permit = request.add_active();
    permit->set_lane(lane);
    permit->set_policy_version(kPublishedVersion);
  }
  const auto stream = stub_->Play(&context);
  v1::ActorMessage message;
  *message.mutable_permits() = request;
  EXPECT_TRUE(stream->Write(message));
  absl::SleepFor(absl::Milliseconds(100));
  context.TryCancel();
  stream->Finish().IgnoreError();
  int granted = 0;
  for (int i = 0; i < 49 && granted == 0; ++i) {  // less than the lease
    absl::SleepFor(absl::Milliseconds(100));
    clock_.Advance(absl::Milliseconds(100));
    granted = GetPermits("b")->granted_size();
  }
  EXPECT_EQ(granted, kSampleShape.lanes);
}

TEST_F(LearnerServiceTest, AFragmentReachesTheTrainerUnchanged) {
  Enter("a");
  const auto verdicts = Push({Message("a", 1, 0), Message("a", 0, 0)});
  ASSERT_THAT(verdicts, IsOk());
  ASSERT_EQ(verdicts->size(), 2);
  EXPECT_EQ((*verdicts)[0].lane(), 1);
  EXPECT_EQ((*verdicts)[0].number(), 0);
  EXPECT_EQ((*verdicts)[0].verdict(), v1::FragmentVerdict::ACCEPTED);
  EXPECT_EQ((*verdicts)[1].lane(), 0);
  ExpectSameFragments(*fragments_.Pop(absl::ZeroDuration()), SampleFragment(1, 0, kPublishedVersion, kEpoch));
  ExpectSameFragments(*fragments_.Pop(absl::ZeroDuration()), SampleFragment(0, 0, kPublishedVersion, kEpoch));
  auto snapshot = GetSnapshot(1, 1);
  ASSERT_THAT(snapshot, IsOk());
  EXPECT_EQ(wire::FromProto(&*snapshot, kSampleShape.state_size).value(),
            SampleFragment(1, 0, kPublishedVersion).snapshot);
}

TEST(FragmentDigest, CoversTheContentButNotEpochAndSender) {
  const Fragment fragment = SampleFragment(2, 7, 40);
  const uint64_t digest = FragmentDigest(fragment);
  Fragment same = SampleFragment(2, 7, 40, /*epoch=*/9);
  same.sender = "another";
  same.digest = 17;
  EXPECT_EQ(FragmentDigest(same), digest);
  const std::vector<std::function<void(Fragment*)>> changes = {
      [](Fragment* f) { f->lane = 1; },
      [](Fragment* f) { ++f->number; },
      [](Fragment* f) { ++f->policy_version; },
      [](Fragment* f) { f->frames[0] ^= 1; },
      [](Fragment* f) { f->frames.back() ^= 1; },
      [](Fragment* f) { f->actions[4] ^= 1; },
      [](Fragment* f) { f->log_probs[1] = std::nextafter(f->log_probs[1], 0.0F); },
      [](Fragment* f) { f->values[1] = -0.0F; },
      [](Fragment* f) { f->rewards[4] = 0; },
      [](Fragment* f) { std::swap(f->ends[1], f->ends[2]); },
      [](Fragment* f) { f->truncation_values[0] = 0; },
      [](Fragment* f) { f->bootstrap_value = 0; },
      [](Fragment* f) { f->episodes[0].length = 2; },
      [](Fragment* f) { f->episodes[0].reward += 1e-12; },
      [](Fragment* f) { ++f->episodes[1].achievements[21]; },
      [](Fragment* f) { f->states[0] = 0; },
      [](Fragment* f) { f->snapshot.game.back() ^= 1; },
      [](Fragment* f) { f->snapshot.state[1] = 0; },
      [](Fragment* f) { f->frames += f->actions, f->actions.clear(); },
  };
  for (size_t i = 0; i < changes.size(); ++i) {
    Fragment other = fragment;
    changes[i](&other);
    EXPECT_NE(FragmentDigest(other), digest) << i;
  }
}

TEST_F(LearnerServiceTest, AFragmentSentTwiceIsAcceptedOnce) {
  Enter("a");
  const auto verdicts = Push({Message("a", 1, 0), Message("a", 1, 0)});
  ASSERT_THAT(verdicts, IsOk());
  EXPECT_EQ((*verdicts)[1].verdict(), v1::FragmentVerdict::DUPLICATE);
  EXPECT_EQ(fragments_.size(), 1);
  EXPECT_EQ(Metric("fragments_accepted"), 1);
  EXPECT_EQ(Metric("fragments_duplicate"), 1);
}

TEST_F(LearnerServiceTest, AnInvalidFragmentIsRefusedAndTheStreamGoesOn) {
  Enter("a");
  const auto refused = [this](v1::FragmentMessage message, const std::string& error) {
    const auto verdicts = Push({std::move(message), Message("a", 1, 1)});
    ASSERT_THAT(verdicts, IsOk());
    ASSERT_EQ(verdicts->size(), 2);
    EXPECT_EQ((*verdicts)[0].verdict(), v1::FragmentVerdict::REFUSED);
    EXPECT_THAT((*verdicts)[0].reason(), HasSubstr(error));
    EXPECT_EQ((*verdicts)[1].verdict(), v1::FragmentVerdict::EXPIRED) << "it has no permit for the next fragment";
  };
  v1::FragmentMessage cut = Message("a", 0, 0);
  cut.mutable_frames()->pop_back();
  refused(cut, "frames: 59 bytes, want 60");
  v1::FragmentMessage wild = Message("a", 0, 0);
  (*wild.mutable_actions())[1] = 17;
  refused(wild, "action 17 at 1, want 0..16");
  wild = Message("a", 0, 0);
  wild.set_log_probs(2, 40);
  refused(wild, "fragment 0 of lane 0 of actor a: log_probs: 40 at 2, want -104..0");
  wild = Message("a", 0, 0);
  wild.set_snapshot(std::string(9000, 's'));
  refused(wild, "fragment 0 of lane 0 of actor a: snapshot: 9000 bytes without");
  refused(Message("a", 3, 0), "lane 3, want 0..2");
  refused(Message("a", 0, 0, kPublishedVersion - 1), "policy_version 10 for fragment 0 of lane 0, want 11");
  EXPECT_EQ(Metric("fragments_rejected"), 6);
  EXPECT_EQ(GetSnapshot(0, 0)->snapshot(), "") << "the lane has not advanced";

  const auto verdicts = Push({Message("a", 0, 0)});
  ASSERT_THAT(verdicts, IsOk());
  EXPECT_EQ((*verdicts)[0].verdict(), v1::FragmentVerdict::ACCEPTED);
}

TEST_F(LearnerServiceTest, ValuesBeyondWhatTheCriticOfTheirWeightsCanSayAreRefused) {
  weights_.Publish(kPublishedVersion, std::make_shared<HostWeights>("weights"), {-50, 100});
  Enter("a");
  for (const float value : {101.0F, -51.0F}) {
    for (const auto& set : std::vector<std::function<void(v1::FragmentMessage*)>>{
             [&](auto* m) { m->set_values(1, value); }, [&](auto* m) { m->set_truncation_values(0, value); },
             [&](auto* m) { m->set_bootstrap_value(value); }}) {
      v1::FragmentMessage wild = Message("a", 1, 0);
      set(&wild);
      const v1::FragmentVerdict verdict = Push({wild}).value()[0];
      EXPECT_EQ(verdict.verdict(), v1::FragmentVerdict::REFUSED);
      EXPECT_THAT(verdict.reason(), AllOf(HasSubstr("actor a: "), HasSubstr("value"), HasSubstr("want -50..100")));
    }
  }
  EXPECT_EQ(Push({Message("a", 1, 0)}).value()[0].verdict(), v1::FragmentVerdict::ACCEPTED);
}

// Nothing is drawn, converted or digested for a stranger.
TEST_F(LearnerServiceTest, FragmentsWithoutPermitAreExpiredAndTheirContentIsNotLookedAt) {
  Enter("a");
  const auto garbage = [](v1::FragmentMessage message) {
    message.set_frames("none");
    message.set_frame_format(v1::FRAMES_SCENE);
    return message;
  };
  const auto verdicts = Push({garbage(Message("stranger", 0, 0)), garbage(Message("a", 0, 5)),
                              garbage(Message("a", 0, 0, kPublishedVersion, kEpoch - 1)), garbage(Message("a", 0, 0))});
  ASSERT_THAT(verdicts, IsOk());
  ASSERT_EQ(verdicts->size(), 4);
  for (int i = 0; i < 3; ++i) EXPECT_EQ((*verdicts)[i].verdict(), v1::FragmentVerdict::EXPIRED) << i;
  EXPECT_EQ((*verdicts)[1].number(), 5);
  EXPECT_EQ((*verdicts)[3].verdict(), v1::FragmentVerdict::REFUSED) << "this one was wanted";
  EXPECT_EQ(fragments_.size(), 0);
  EXPECT_EQ(Metric("fragments_expired"), 3);
}

TEST_F(LearnerServiceTest, ImpossibleRequestsForPermitsAreRefused) {
  ASSERT_THAT(Join("a"), IsOk());
  v1::PermitRequest request;
  request.set_actor("a");
  request.set_epoch(kEpoch);
  request.add_active()->set_lane(3);
  EXPECT_THAT(Ask(request), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("active: lane 3, want 0..2")));
}

// The only actor reports twice that a lane's game can't be restored.
TEST_F(LearnerServiceTest, ALaneWithAnInvalidSnapshotIsReset) {
  Enter("a");
  ASSERT_THAT(Push({Message("a", 1, 0)}), IsOk());
  v1::PermitRequest request;
  request.set_actor("a");
  request.set_epoch(kEpoch);
  request.set_capacity(100);
  v1::LaneFailure* failure = request.add_failures();
  failure->set_lane(1);
  failure->set_fragment(1);
  failure->set_reason("not a world's");
  // The granted fragment of lane 1.
  const auto granted = [](const absl::StatusOr<v1::PermitReply>& reply) -> int64_t {
    for (const v1::Permit& permit : reply->granted()) {
      if (permit.lane() == 1) return permit.fragment();
    }
    return -1;
  };
  ASSERT_EQ(granted(GetPermits("a")), 1);
  EXPECT_EQ(granted(Ask(request)), 1);
  EXPECT_EQ(Metric("lanes_reset"), 0);
  EXPECT_EQ(granted(Ask(request)), 0) << "played again";
  EXPECT_EQ(Metric("lanes_reset"), 1);
}

TEST_F(LearnerServiceTest, TheSecondResultForAFragmentIsCompared) {
  Enter("a");
  ASSERT_THAT(Push({Message("a", 0, 0)}), IsOk());
  ASSERT_THAT(Push({Message("a", 0, 0)}), IsOk());
  EXPECT_EQ(Metric("fragments_differing"), 0);
  v1::FragmentMessage other = Message("a", 0, 0);
  other.set_rewards(0, 0.5F);
  ASSERT_THAT(Push({other}), IsOk());
  EXPECT_EQ(Metric("fragments_differing"), 1);
}

TEST_F(LearnerServiceTest, AcceptsNothingOnceItStops) {
  Enter("a");
  fragments_.Close();
  EXPECT_THAT(Push({Message("a", 0, 0)}), StatusIs(absl::StatusCode::kCancelled, HasSubstr("queue closed")));
}

TEST_F(LearnerServiceTest, SnapshotsAreOfTheNextFragment) {
  ASSERT_THAT(GetSnapshot(2, 0), IsOk());
  EXPECT_EQ(GetSnapshot(2, 0)->snapshot(), "") << "not begun yet";
  EXPECT_THAT(GetSnapshot(2, 1), StatusIs(absl::StatusCode::kAborted, HasSubstr("lane 2 is at fragment 0, not 1")));
  EXPECT_THAT(GetSnapshot(3, 0), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("lane 3, want 0..2")));
  EXPECT_THAT(GetSnapshot(2, 0, kEpoch + 1), StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
}

TEST_F(LearnerServiceTest, ALeavingActorReturnsItsLanes) {
  Enter("a");
  v1::LeaveRequest request;
  request.set_actor("a");
  ASSERT_THAT(Call(&v1::LearnerService::Stub::Leave, request), IsOk());
  Enter("b");
  const auto verdicts = Push({Message("a", 0, 0)});
  EXPECT_EQ((*verdicts)[0].verdict(), v1::FragmentVerdict::EXPIRED);
}

TEST_F(LearnerServiceTest, StatusListsTheActors) {
  Enter("a");
  ASSERT_THAT(Push({Message("a", 0, 0)}), IsOk());
  clock_.Advance(absl::Seconds(3));
  v1::StatusReply reply;
  service_.FillStatus(&reply);
  EXPECT_EQ(reply.run_id(), "run-a");
  ASSERT_EQ(reply.peers_size(), 1);
  EXPECT_EQ(reply.peers(0).name(), "a");
  EXPECT_EQ(reply.peers(0).state(), "2 permits, 1 fragments accepted");
  EXPECT_EQ(reply.peers(0).last_seen_s(), 3);
}

TEST_F(LearnerServiceTest, AnActorThatEvaluatesGetsATaskAndReturnsItsResult) {
  ASSERT_THAT(Join("a"), IsOk());
  registry_.AddEvaluation({1, 4096, 11, 2, false, std::make_shared<HostWeights>("old weights")});
  ASSERT_FALSE(GetPermits("a")->has_evaluation()) << "it does not play evaluations";
  const auto ask = [&](int64_t at_hand) {
    v1::PermitRequest request;
    request.set_actor("a");
    request.set_epoch(kEpoch);
    request.set_evaluates(true);
    request.set_evaluation(at_hand);
    return Ask(request).value();
  };
  const v1::EvaluationTask task = ask(0).evaluation();
  EXPECT_EQ(task.env().name(), "crafter:numbers=easy-x2");
  EXPECT_EQ(task.env().frame_size(), 64);
  EXPECT_EQ(task.seed(), 7);
  EXPECT_EQ(task.first_episode(), 11);
  EXPECT_EQ(task.episodes(), 2);
  EXPECT_TRUE(task.greedy());
  EXPECT_FALSE(ask(task.id()).has_evaluation()) << "one at a time";

  const auto weights = [&]() -> absl::StatusOr<std::string> {
    grpc::ClientContext context;
    v1::WeightsRequest request;
    request.set_evaluation(task.id());
    v1::WeightsChunk chunk;
    const auto stream = stub_->GetWeights(&context, request);
    stream->Read(&chunk);
    if (const grpc::Status status = stream->Finish(); !status.ok()) return wire::FromGrpc(status, "learner");
    return chunk.data();
  };
  EXPECT_EQ(weights().value(), "old weights");

  v1::EvaluationResult result;
  result.set_actor("a");
  result.set_epoch(kEpoch);
  result.set_id(task.id());
  EXPECT_THAT(Call(&v1::LearnerService::Stub::FinishEvaluation, result),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("0 episodes, want 2")));
  for (int i = 0; i < 2; ++i) {
    v1::EpisodeMessage* episode = result.add_episodes();
    episode->set_length(30 + i);
    for (int k = 0; k < kNumAchievements; ++k) episode->add_achievements(0);
  }
  result.set_actor("b");
  EXPECT_THAT(Call(&v1::LearnerService::Stub::FinishEvaluation, result),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("actor b is unknown: join again")));
  EXPECT_EQ(weights().value(), "old weights") << "the task goes on";
  result.set_actor("a");
  EXPECT_THAT(Call(&v1::LearnerService::Stub::FinishEvaluation, result), IsOk());
  EXPECT_THAT(weights(), StatusIs(absl::StatusCode::kAborted, HasSubstr("is over")));
  result.set_epoch(kEpoch - 1);
  EXPECT_THAT(Call(&v1::LearnerService::Stub::FinishEvaluation, result),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
  result.set_epoch(kEpoch);
  result.mutable_episodes(1)->set_length(0);
  EXPECT_THAT(Call(&v1::LearnerService::Stub::FinishEvaluation, result),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("length 0")));
}

}  // namespace
}  // namespace craftfleet
