// Actors with a real lane scheduler and real games: the fragments they send are correct under all kinds of faults.

#include "actor/actor.h"

#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/keyed_random.h"
#include "common/base/seeds.h"
#include "common/telemetry/log.h"
#include "tests/actor/stand_in_learner.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/failing_once_service.h"
#include "tests/fakes/metric_of.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;

// An actor on its own thread.
class RunningActor {
 public:
  RunningActor(const wire::Endpoint& learner, const std::vector<wire::Endpoint>& env_servers, int threads = 1) {
    Actor::Options options;
    options.learner = learner;
    options.env_servers = std::make_shared<EnvDirectory>(env_servers);
    options.threads = threads;
    actor_ = *Actor::Create(options);
    thread_ = std::thread([this] {
      status_ = actor_->Run("no address");
      if (!status_.ok()) LogWarning("the actor ended: %s", status_.message());
    });
  }
  ~RunningActor() {
    actor_->Stop();
    Join().IgnoreError();
  }
  // Returns the status of Run.
  absl::Status Join() {
    if (thread_.joinable()) thread_.join();
    return status_;
  }
  void Stop() { actor_->Stop(); }
  double Metric(const std::string& name) const {
    v1::StatusReply reply;
    actor_->FillStatus(&reply);
    return MetricOf(reply, name);
  }

 private:
  std::unique_ptr<Actor> actor_;
  std::thread thread_;
  absl::Status status_;
};

// Plays the games of all lanes without actor, server or learner, to obtain the expected fragments.
class Reference {
 public:
  explicit Reference(const std::string& agent) : agent_(agent) {
    const auto renderer = MakeRenderer(kLength);
    for (int lane = 0; lane < kLanes; ++lane) {
      games_.push_back(std::make_unique<PlayedGame>(renderer, LaneSeed(Config(agent).seed(), lane)));
      states_.emplace_back(FindAgent(agent)->state_size);
    }
  }

  std::vector<Fragment> Play(int64_t iteration) {
    const auto policy = SamplePolicy(iteration, Config(agent_).tile(), agent_);
    std::vector<Fragment> fragments;
    for (int lane = 0; lane < kLanes; ++lane) {
      for (int64_t i = 0; i < kFragmentsPerIteration; ++i) {
        fragments.push_back(PlayOne(*policy, lane, iteration * kFragmentsPerIteration + i, iteration));
      }
    }
    return fragments;
  }

 private:
  Fragment PlayOne(const Policy& policy, int lane, int64_t number, int64_t version) {
    Fragment fragment;
    fragment.epoch = 1;
    fragment.lane = lane;
    fragment.number = number;
    fragment.policy_version = version;
    PlayedGame& game = *games_[lane];
    for (int t = 0; t < kSteps; ++t) {
      const double noise = ActionNoise(Config(agent_).seed(), lane, number * kSteps + t);
      std::vector<float>& state = states_[lane];
      fragment.states.insert(fragment.states.end(), state.begin(), state.end());
      const ActResult act = *policy.Act(game.frame, {lane}, {noise}, absl::MakeSpan(state));
      fragment.frames += game.frame;
      fragment.actions.push_back(static_cast<char>(act.actions[0]));
      fragment.log_probs.push_back(act.log_probs[0]);
      fragment.values.push_back(act.values[0]);
      game.last_frames.clear();
      const Game::PlayedStep played = game.Step(act.actions[0]);
      fragment.rewards.push_back(static_cast<float>(played.outcome.reward));
      fragment.ends.push_back(played.outcome.end);
      if (played.outcome.end == StepEnd::kTruncated) {
        fragment.truncation_values.push_back(policy.Values(game.last_frames, {lane}, state)->front());
      }
      if (played.outcome.end != StepEnd::kNone) state.assign(state.size(), 0);
      if (!played.episode.has_value()) continue;
      fragment.episodes.push_back(*played.episode);
      fragment.episodes.back().step = t;
    }
    fragment.bootstrap_value = policy.Values(game.frame, {lane}, states_[lane])->front();
    fragment.snapshot = {game.game.Save(), states_[lane]};
    return fragment;
  }

  const std::string agent_;
  std::vector<std::vector<float>> states_;
  std::vector<std::unique_ptr<PlayedGame>> games_;
};

class ActorTest : public testing::Test {
 protected:
  explicit ActorTest(std::string agent = "ppo_cnn") : agent_(std::move(agent)) {}

  std::unique_ptr<StandInLearner> MakeLearner(const std::string& texture_digest = "") const {
    return std::make_unique<StandInLearner>(agent_, LearnerAddress(), 1, NewLanes(agent_), texture_digest);
  }
  std::string LearnerAddress() const { return "unix:" + (folder_ / "learner"); }
  // Expects the iteration's fragments to equal those of the reference.
  void ExpectIteration(StandInLearner* learner, int64_t iteration, int64_t epoch = 1) {
    const std::vector<Fragment> fragments = learner->Collect();
    std::vector<Fragment> wanted = reference_.Play(iteration);
    ASSERT_EQ(fragments.size(), wanted.size());
    for (size_t i = 0; i < wanted.size(); ++i) {
      SCOPED_TRACE(testing::Message() << "lane " << wanted[i].lane << " fragment " << wanted[i].number);
      wanted[i].epoch = epoch;
      ExpectSameFragments(fragments[i], wanted[i]);
    }
  }

  const std::string agent_;
  const TempFolder folder_;
  EnvServer env_;
  Reference reference_{agent_};
  std::unique_ptr<StandInLearner> learner_ = MakeLearner();
};

class ActorOfEachKind : public ActorTest, public testing::WithParamInterface<std::string> {
 protected:
  ActorOfEachKind() : ActorTest(GetParam()) {}
};

TEST_P(ActorOfEachKind, SendsTheGamesThatItPlayed) {
  RunningActor actor(learner_->Connect(), {env_.Connect()});
  for (int64_t iteration = 0; iteration < 3; ++iteration) {
    learner_->Open(iteration);
    ExpectIteration(learner_.get(), iteration);
  }
  EXPECT_TRUE(WaitUntil([&] { return actor.Metric("fragments_accepted") == 3 * kLanes * kFragmentsPerIteration; }));
  EXPECT_EQ(actor.Metric("env_steps"), 3 * kLanes * kFragmentsPerIteration * kSteps);
  EXPECT_EQ(actor.Metric("fragments_abandoned"), 0);
}

TEST_P(ActorOfEachKind, ManyActorsProduceTheFragmentsOfOne) {
  const EnvServer second;
  RunningActor a(learner_->Connect(), {env_.Connect(), second.Connect()}, 2);
  RunningActor b(learner_->Connect(), {second.Connect()});
  RunningActor c(learner_->Connect(), {env_.Connect()}, 3);
  for (int64_t iteration = 0; iteration < 3; ++iteration) {
    learner_->Open(iteration);
    ExpectIteration(learner_.get(), iteration);
  }
}

TEST_F(ActorTest, LeavesWhenTheRunIsOver) {
  RunningActor actor(learner_->Connect(), {env_.Connect()});
  ASSERT_TRUE(WaitUntil([this] { return learner_->registry().Actors().size() == 1; }));
  learner_->registry().Finish();
  EXPECT_THAT(actor.Join(), IsOk());
  EXPECT_THAT(learner_->registry().Actors(), IsEmpty());
}

TEST_P(ActorOfEachKind, AStoppedActorReturnsItsLanes) {
  auto first = std::make_unique<RunningActor>(learner_->Connect(), std::vector<wire::Endpoint>{env_.Connect()});
  learner_->Open(0);
  ExpectIteration(learner_.get(), 0);
  learner_->Open(1);  // the actor is stopped in the middle of fragments
  const absl::Time start = absl::Now();
  first->Stop();
  EXPECT_THAT(first->Join(), IsOk());
  EXPECT_LT(absl::Now() - start, absl::Seconds(5));
  RunningActor second(learner_->Connect(), {env_.Connect()});
  ExpectIteration(learner_.get(), 1);
}

// No lease lapses within the test (kLease).
TEST_F(ActorTest, OtherActorsContinueTheLanesOfAStoppedActorAtOnce) {
  learner_->registry().OpenIteration(1000 * kFragmentsPerIteration, 0);
  RunningActor first(learner_->Connect(), {env_.Connect()});
  RunningActor second(learner_->Connect(), {env_.Connect()});
  learner_->Publish(0);
  ASSERT_TRUE(WaitUntil([this] { return learner_->OutstandingPermits() == std::vector<int>{2, 2}; }));
  const absl::Time start = absl::Now();
  first.Stop();
  EXPECT_TRUE(WaitUntil([this] { return learner_->OutstandingPermits() == std::vector<int>{4}; }));
  EXPECT_LT(absl::Now() - start, absl::Seconds(5));
  EXPECT_THAT(first.Join(), IsOk());
  EXPECT_EQ(learner_->registry().lanes()->table().counters.lapsed, 0);
}

TEST_F(ActorTest, ANewActorGetsItsShareWithin5Seconds) {
  learner_->registry().OpenIteration(1000 * kFragmentsPerIteration, 0);
  learner_->Publish(0);
  RunningActor first(learner_->Connect(), {env_.Connect()});
  ASSERT_TRUE(WaitUntil([this] { return learner_->OutstandingPermits() == std::vector<int>{4}; }));
  const absl::Time start = absl::Now();
  RunningActor second(learner_->Connect(), {env_.Connect()});
  EXPECT_TRUE(WaitUntil([this] { return learner_->OutstandingPermits() == std::vector<int>{2, 2}; }));
  EXPECT_LT(absl::Now() - start, absl::Seconds(5));
}

// A hanging learner must not delay the stop.
TEST_F(ActorTest, StopsWhileItWaitsForWeights) {
  learner_->registry().OpenIteration(kFragmentsPerIteration, 0);  // with weights that are never published
  RunningActor actor(learner_->Connect(), {env_.Connect()});
  ASSERT_TRUE(WaitUntil([this] { return learner_->OutstandingPermits() == std::vector<int>{4}; }));
  const absl::Time start = absl::Now();
  actor.Stop();
  EXPECT_THAT(actor.Join(), IsOk());
  EXPECT_LT(absl::Now() - start, absl::Seconds(3));
}

TEST_P(ActorOfEachKind, AnExceptionInAnEnvironmentServerCostsOnlyAFragment) {
  FailingOnceService failing(env_.service.get(), 5);  // at the third step
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {&failing});
  RunningActor actor(learner_->Connect(), {wire::Connect(server->address())});
  for (int64_t iteration = 0; iteration < 2; ++iteration) {
    learner_->Open(iteration);
    ExpectIteration(learner_.get(), iteration);
  }
  EXPECT_GT(actor.Metric("fragments_abandoned"), 0);
  EXPECT_LE(actor.Metric("fragments_abandoned"), kLanes);
}

// Otherwise games of lanes that other actors now play would stay open forever.
TEST_P(ActorOfEachKind, ClosesTheGamesOfLanesThatOthersPlay) {
  EnvServer of_first;
  RunningActor first(learner_->Connect(), {of_first.Connect()});
  learner_->Open(0);
  ExpectIteration(learner_.get(), 0);
  RunningActor second(learner_->Connect(), {env_.Connect()});
  ASSERT_TRUE(WaitUntil([this] { return learner_->registry().Actors().size() == 2; }));
  for (int64_t iteration = 1; iteration < 4; ++iteration) {
    learner_->Open(iteration);
    ExpectIteration(learner_.get(), iteration);
  }
  v1::StatusReply status;
  of_first.service->FillStatus(&status);
  ASSERT_EQ(status.peers_size(), 1);
  EXPECT_EQ(status.peers(0).state(), "2 lanes");
}

TEST_P(ActorOfEachKind, ContinuesWhenAnEnvironmentServerStops) {
  const EnvServer second;
  RunningActor actor(learner_->Connect(), {env_.Connect(), second.Connect()});
  learner_->Open(0);
  ExpectIteration(learner_.get(), 0);
  second.server->Stop(absl::Milliseconds(10));
  learner_->Open(1);
  ExpectIteration(learner_.get(), 1);
  EXPECT_GT(actor.Metric("fragments_abandoned"), 0);
}

TEST_P(ActorOfEachKind, ContinuesAfterTheLearnerRestarts) {
  RunningActor actor(learner_->Connect(), {env_.Connect()});
  learner_->Open(0);
  ExpectIteration(learner_.get(), 0);
  const std::vector<LaneRecord> checkpoint = learner_->registry().Records();
  learner_->Open(1);
  ASSERT_TRUE(learner_->fragments().Pop(absl::Minutes(1)).has_value()) << "in the middle of the iteration";
  learner_.reset();
  learner_ = std::make_unique<StandInLearner>(agent_, LearnerAddress(), 2, checkpoint);
  learner_->Open(1);
  ExpectIteration(learner_.get(), 1, 2);
}

TEST_F(ActorTest, ALearnerThatRestartsDoesNotWaitForAnEvaluationOfItsFormerStart) {
  constexpr int kMany = 10'000;
  const auto weights = std::make_shared<const HostWeights>(SampleWeights(0, agent_));
  const auto evaluation = [&](int episodes) { return Evaluation{1, 0, 1, episodes, /*final=*/true, weights}; };
  const auto episodes_played = [this] {
    v1::StatusReply status;
    env_.service->FillStatus(&status);
    return MetricOf(status, "episodes");
  };
  learner_->registry().AddEvaluation(evaluation(kMany));
  RunningActor actor(learner_->Connect(), {env_.Connect()});
  ASSERT_TRUE(WaitUntil([&] { return episodes_played() > 0; }));
  learner_.reset();
  learner_ = std::make_unique<StandInLearner>(agent_, LearnerAddress(), 2, NewLanes(agent_));
  learner_->registry().AddEvaluation(evaluation(1));
  EXPECT_TRUE(WaitUntil([this] { return learner_->registry().evaluations()->FrontFinished(); }));
  EXPECT_LT(episodes_played(), kMany) << "the former one was dropped";
}

// Its lanes must not have to wait until it can play.
TEST_F(ActorTest, AnActorThatCannotPlayLetsOthersPlay) {
  wire::Endpoint gone;
  {
    const EnvServer server;
    gone = server.Connect();
  }
  RunningActor unable(learner_->Connect(), {gone});
  ASSERT_TRUE(WaitUntil([this] { return learner_->registry().Actors().size() == 1; }));
  learner_->Open(0);
  ASSERT_TRUE(WaitUntil([&] { return unable.Metric("fragments_abandoned") > 0; }));
  RunningActor able(learner_->Connect(), {env_.Connect()});
  const absl::Time start = absl::Now();
  ExpectIteration(learner_.get(), 0);
  learner_->Open(1);
  ExpectIteration(learner_.get(), 1);
  EXPECT_LT(absl::Now() - start, absl::Seconds(20));
  EXPECT_EQ(unable.Metric("fragments_accepted"), 0);
}

TEST_F(ActorTest, WaitsForALearnerThatIsNotRunningYet) {
  learner_.reset();
  RunningActor actor(wire::Connect(LearnerAddress()), {env_.Connect()});
  absl::SleepFor(absl::Milliseconds(300));
  learner_ = MakeLearner();
  learner_->Open(0);
  ExpectIteration(learner_.get(), 0);
}

TEST_F(ActorTest, StopsWhileItWaitsForALearner) {
  learner_.reset();
  RunningActor actor(wire::Connect(LearnerAddress()), {env_.Connect()});
  absl::SleepFor(absl::Milliseconds(100));
  const absl::Time start = absl::Now();
  actor.Stop();
  EXPECT_THAT(actor.Join(), IsOk());
  EXPECT_LT(absl::Now() - start, absl::Seconds(6));
}

TEST_F(ActorTest, EndsWhenTheTexturesDiffer) {
  learner_.reset();
  learner_ = MakeLearner("0123456789abcdef");
  RunningActor actor(learner_->Connect(), {env_.Connect()});
  learner_->Open(0);
  EXPECT_THAT(actor.Join(), StatusIs(absl::StatusCode::kFailedPrecondition,
                                     AllOf(HasSubstr(env_.server->address()), HasSubstr("0123456789abcdef"))));
}

INSTANTIATE_TEST_SUITE_P(Actor, ActorOfEachKind, testing::Values("ppo_cnn", "lstm_cnn"),
                         [](const auto& info) { return info.param; });

TEST(ActorOptions, AreCheckedByName) {
  const wire::Endpoint somewhere = wire::Connect("127.0.0.1:1");
  const auto servers = std::make_shared<EnvDirectory>(std::vector<wire::Endpoint>{somewhere});
  EXPECT_THAT((Actor::Options{somewhere, servers, 0, 1}.Validate()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--threads=0, want 1..256")));
  EXPECT_THAT((Actor::Options{somewhere, servers, 1, 4097}.Validate()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--max_lanes=4097, want 1..4096")));
  EXPECT_THAT((Actor::Options{somewhere, servers, 256, 4096}.Validate()), IsOk());
}

}  // namespace
}  // namespace craftfleet
