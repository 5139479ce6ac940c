#include "deploy/cli/watch/agent_game.h"

#include <numeric>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/evaluator.h"
#include "common/io/paths.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "tests/deploy/cli/watch/watched_game.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

// The episodes of `craftfleet eval`.
std::vector<Episode> EvaluatedEpisodes(const Policy& policy, int frame_bytes, bool greedy, int length = 40) {
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir());
  const auto server = *wire::Server::Create({}, {service.get()});
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  hello.mutable_env()->set_name("crafter");
  hello.mutable_env()->set_frame_size(64);
  hello.mutable_env()->set_length(length);
  EnvClient env(server->InProcess(), hello, frame_bytes, absl::Seconds(60));
  EXPECT_THAT(env.Connect(absl::Seconds(5)), IsOk());
  EvaluationOptions options;
  options.seed = 5;
  options.first_episode = 3;
  options.episodes = 2;
  options.greedy = greedy;
  return *Evaluate(options, policy, &env, [](int) {});
}

TEST(AgentGame, PlaysTheEpisodesOfEval) {
  for (const bool greedy : {false, true}) {
    const std::shared_ptr<const Policy> policy = SamplePolicy(1);
    const auto episodes = EvaluatedEpisodes(*policy, 3 * 64 * 64, greedy);
    ASSERT_EQ(episodes.size(), 2U);
    AgentGame::Options options = WatchedOptions();
    options.greedy = greedy;
    const auto game = AgentGame::Create(options, policy, 3);
    ASSERT_THAT(game, IsOk());
    for (int number = 0; number < 2; ++number) {
      ASSERT_THAT((*game)->Start(policy, 3 + number), IsOk());
      while (!(*game)->ended()) ASSERT_THAT((*game)->Step(), IsOk());
      EXPECT_EQ((*game)->world().episode(), 3 + number);
      EXPECT_EQ((*game)->world().step(), episodes[number].length);
      EXPECT_EQ((*game)->world().episode_reward(), episodes[number].reward);
      EXPECT_EQ((*game)->world().player().achievements, episodes[number].achievements);
    }
  }
}

// Whose network has a memory of the last achievement, which changes what it plays after one.
std::unique_ptr<const Policy> PolicyWithMemory() {
  v1::RunConfig config;
  config.set_agent("ppo_cnn");
  config.mutable_network()->set_memory(true);
  const AgentSpec spec = *MakeAgentSpec(config);
  return *Policy::Create(spec, SampleWeights(1, spec), 1);
}

TEST(AgentGame, RemembersAchievementsAsEvalDoes) {
  const std::shared_ptr<const Policy> policy = PolicyWithMemory();
  ASSERT_TRUE(policy->has_memory());
  const Episode episode = EvaluatedEpisodes(*policy, 3 * 64 * 64, /*greedy=*/false, /*length=*/200)[0];
  ASSERT_GT(CountUnlocked(episode.achievements), 0);
  const auto game = AgentGame::Create(WatchedOptions(200), policy, 3);
  ASSERT_THAT(game, IsOk());
  while (!(*game)->ended()) ASSERT_THAT((*game)->Step(), IsOk());
  EXPECT_EQ((*game)->world().step(), episode.length);
  EXPECT_EQ((*game)->world().episode_reward(), episode.reward);
  EXPECT_EQ((*game)->world().player().achievements, episode.achievements);
}

TEST(AgentGame, RepeatsAnEpisodeOfARecurrentAgent) {
  const std::shared_ptr<const Policy> policy = SamplePolicy(1, 1, "lstm_cnn");
  const auto game = AgentGame::Create(WatchedOptions(), policy, 1);
  ASSERT_THAT(game, IsOk());
  std::vector<float> values[2];
  for (auto& list : values) {
    ASSERT_THAT((*game)->Start(policy, 1), IsOk());
    while (!(*game)->ended()) {
      list.push_back((*game)->decision().value);
      ASSERT_THAT((*game)->Step(), IsOk());
    }
  }
  EXPECT_EQ(values[0], values[1]);
}

TEST(AgentGame, DecidesWithProbabilities) {
  const auto game = AgentGame::Create(WatchedOptions(), SamplePolicy(1), 1);
  ASSERT_THAT(game, IsOk());
  const AgentGame::Decision decision = (*game)->decision();
  EXPECT_NEAR(std::accumulate(decision.odds.probs.begin(), decision.odds.probs.end(), 0.0), 1, 1e-9);
  EXPECT_GT(decision.odds.probs[static_cast<int>(decision.action)], 0);
}

TEST(AgentGame, AnEndedEpisodeStays) {
  const auto game = AgentGame::Create(WatchedOptions(3), SamplePolicy(1), 1);
  ASSERT_THAT(game, IsOk());
  for (int i = 0; i < 5; ++i) ASSERT_THAT((*game)->Step(), IsOk());
  EXPECT_TRUE((*game)->ended());
  EXPECT_EQ((*game)->world().step(), 3);
}

}  // namespace
}  // namespace craftfleet
