#include "actor/evaluator.h"

#include <algorithm>
#include <atomic>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/keyed_random.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace evaluator_test {

using testing::HasSubstr;

constexpr int kLength = 30;  // of an episode

class EvaluatorTest : public testing::Test {
 protected:
  absl::StatusOr<std::vector<Episode>> Run(const EvaluationOptions& options, uint64_t weights = 1,
                                           const std::string& agent = "ppo_cnn") {
    EnvClient client(env_.Connect(), SampleHello(kLength), 64 * 64 * 3);
    if (absl::Status status = client.Connect(absl::Seconds(10)); !status.ok()) return status;
    finished_.clear();
    return Evaluate(options, *SamplePolicy(weights, 8, agent), &client, [this](int n) { finished_.push_back(n); });
  }

  EnvServer env_;
  std::vector<int> finished_;  // arguments of on_step
};

EvaluationOptions Options(int episodes, int lanes) {
  EvaluationOptions options;
  options.seed = 5;
  options.episodes = episodes;
  options.lanes = lanes;
  return options;
}

bool Same(const std::vector<Episode>& a, const std::vector<Episode>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const Episode& x, const Episode& y) {
    return x.length == y.length && x.reward == y.reward && x.achievements == y.achievements;
  });
}

struct Evaluated {
  std::string agent;
  bool greedy;
  int64_t first_episode;
};

class EvaluatedTest : public EvaluatorTest, public testing::WithParamInterface<Evaluated> {};

TEST_P(EvaluatedTest, AnEpisodeDependsNeitherOnOthersNorOnHowManyRunAtOnce) {
  const auto options = [](int episodes, int lanes, int64_t later = 0) {
    EvaluationOptions chosen = Options(episodes, lanes);
    chosen.greedy = GetParam().greedy;
    chosen.first_episode = GetParam().first_episode + later;
    return chosen;
  };
  const std::string agent = GetParam().agent;
  const auto one = Run(options(3, 1), 1, agent);
  ASSERT_THAT(one, IsOk());
  for (const int lanes : {2, 16}) {
    const auto many = Run(options(3, lanes), 1, agent);
    ASSERT_THAT(many, IsOk());
    ExpectSameEpisodes(*many, *one);
    EXPECT_EQ(finished_.back(), 3);
  }
  ExpectSameEpisodes(*Run(options(2, 2, /*later=*/1), 1, agent), {one->begin() + 1, one->end()});
}

// Recurrent states begin with each episode at zero. Training used to hang when evaluations reached episode 10,000.
INSTANTIATE_TEST_SUITE_P(Evaluations, EvaluatedTest,
                         testing::Values(Evaluated{"ppo_cnn", false, 1}, Evaluated{"ppo_cnn", true, 1},
                                         Evaluated{"lstm_cnn", false, 1}, Evaluated{"ppo_cnn", false, 2147483645}));

TEST_F(EvaluatorTest, SeedWeightsAndSamplingChangeTheResult) {
  const auto first = Run(Options(4, 16));
  ASSERT_THAT(first, IsOk());
  EXPECT_FALSE(Same(*first, *Run(Options(4, 16), /*weights=*/2)));
  EvaluationOptions other_seed = Options(4, 16);
  other_seed.seed = 6;
  EXPECT_FALSE(Same(*first, *Run(other_seed)));
  EvaluationOptions greedy = Options(4, 16);
  greedy.greedy = true;
  EXPECT_FALSE(Same(*first, *Run(greedy))) << "sampled actions differ";
}

// Plays the same without a server, with the policy on one frame at a time.
TEST_F(EvaluatorTest, PlaysTheGameOfItsSeed) {
  PlayedGame played(MakeRenderer(kLength), 5);
  const auto policy = SamplePolicy(1);
  std::optional<Episode> episode;
  for (int64_t step = 0; !episode.has_value(); ++step) {
    const ActResult act = *policy->Act(played.frame, {1}, {ActionNoise(5, 1, step)}, {});
    episode = played.Step(act.actions[0]).episode;
  }
  const auto evaluated = Run(Options(1, 1));
  ASSERT_THAT(evaluated, IsOk());
  ExpectSameEpisodes(*evaluated, {*episode});
}

// Records all calls, by episode.
class RecordingObserver : public EpisodeObserver {
 public:
  struct Story {
    std::vector<Moment> moments;
    std::vector<ObservedStep> steps;
  };
  absl::Status OnStart(int64_t number, const Moment& moment) override {
    stories[number].moments.push_back(moment);
    return absl::OkStatus();
  }
  absl::Status OnStep(int64_t number, const ObservedStep& step, const Moment& moment) override {
    stories.at(number).steps.push_back(step);
    stories.at(number).moments.push_back(moment);
    return --steps_to_error == 0 ? absl::DataLossError("seen enough") : absl::OkStatus();
  }
  std::map<int64_t, Story> stories;
  int steps_to_error = -1;
};

v1::SessionHello RecordingHello(int picture_size) {
  v1::SessionHello hello = SampleHello(kLength);
  hello.mutable_recording()->set_picture_size(picture_size);
  return hello;
}

TEST_F(EvaluatorTest, AnObserverSeesEveryEpisodeFromItsFirstMomentToItsLast) {
  const auto unseen = Run(Options(5, 3));
  ASSERT_THAT(unseen, IsOk());
  EnvClient client(env_.Connect(), RecordingHello(90), 64 * 64 * 3);
  ASSERT_THAT(client.Connect(absl::Seconds(10)), IsOk());
  RecordingObserver observer;
  const auto episodes = Evaluate(
      Options(5, 3), *SamplePolicy(1), &client, [](int) {}, &observer);
  ASSERT_THAT(episodes, IsOk());
  ExpectSameEpisodes(*episodes, *unseen);
  ASSERT_EQ(observer.stories.size(), 5);
  for (const auto& [number, story] : observer.stories) {
    const Episode& episode = (*episodes)[number - 1];
    ASSERT_EQ(story.steps.size(), static_cast<size_t>(episode.length));
    ASSERT_EQ(story.moments.size(), story.steps.size() + 1);
    EXPECT_EQ(story.moments.back().achievements, episode.achievements);
    EXPECT_EQ(story.moments.back().picture.size(), 90 * 90 * 3);
    double reward = 0;
    for (const ObservedStep& step : story.steps) reward += step.reward;
    EXPECT_NEAR(reward, episode.reward, 1e-4);
    for (size_t i = 0; i < story.steps.size(); ++i) {
      EXPECT_EQ(story.steps[i].end != StepEnd::kNone, i + 1 == story.steps.size());
    }
  }
}

TEST_F(EvaluatorTest, AStopReturnsTheFinishedEpisodes) {
  const auto all = Run(Options(6, 2));
  ASSERT_THAT(all, IsOk());
  EnvClient client(env_.Connect(), SampleHello(kLength), 64 * 64 * 3);
  ASSERT_THAT(client.Connect(absl::Seconds(10)), IsOk());
  std::atomic<bool> stop{false};
  const auto stop_after_three = [&stop](int finished) { stop = finished >= 3; };
  const auto some = Evaluate(Options(6, 2), *SamplePolicy(1), &client, stop_after_three, nullptr, &stop);
  ASSERT_THAT(some, IsOk());
  ASSERT_GE(some->size(), 3);
  ASSERT_LT(some->size(), 6);
  for (const Episode& episode : *some) {
    EXPECT_TRUE(std::any_of(all->begin(), all->end(), [&](const Episode& other) { return Same({episode}, {other}); }));
  }
}

TEST_F(EvaluatorTest, AnObserversErrorEndsIt) {
  EnvClient client(env_.Connect(), RecordingHello(0), 64 * 64 * 3);
  ASSERT_THAT(client.Connect(absl::Seconds(10)), IsOk());
  RecordingObserver observer;
  observer.steps_to_error = 10;
  EXPECT_THAT(Evaluate(
                  Options(4, 4), *SamplePolicy(1), &client, [](int) {}, &observer),
              StatusIs(absl::StatusCode::kDataLoss, "seen enough"));
}

TEST_F(EvaluatorTest, PicturesThatTheServerCannotDrawAreRefused) {
  EnvClient client(env_.Connect(), RecordingHello(2049), 64 * 64 * 3);
  EXPECT_THAT(client.Connect(absl::Seconds(10)), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("width 2049")));
}

TEST_F(EvaluatorTest, RefusesOptionsOutOfRange) {
  const auto refused = [](const EvaluationOptions& options, const std::string& error) {
    EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(error)));
  };
  refused(Options(0, 1), "--episodes=0");
  refused(Options(10001, 1), "--episodes=10001");
  refused(Options(1, 0), "--lanes=0");
  refused(Options(1, 257), "--lanes=257");
  EvaluationOptions beyond = Options(2, 1);
  beyond.first_episode = 2147483647;
  refused(beyond, "2147483647");
  beyond.first_episode = std::numeric_limits<int64_t>::max();
  refused(beyond, "2147483647");
  EXPECT_THAT(Run(Options(0, 1)), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--episodes")));
}

TEST_F(EvaluatorTest, ReportsTheLossOfTheServer) {
  EnvClient client(env_.Connect(), SampleHello(kLength), 64 * 64 * 3);
  ASSERT_THAT(client.Connect(absl::Seconds(10)), IsOk());
  const auto result =
      Evaluate(Options(4, 4), *SamplePolicy(1), &client, [this](int) { env_.server->Stop(absl::Milliseconds(10)); });
  EXPECT_THAT(result, StatusIs(absl::StatusCode::kUnavailable, HasSubstr(env_.server->address())));
}

}  // namespace evaluator_test
}  // namespace craftfleet
