#include "common/agent/policy.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <thread>

#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "common/agent/initial_weights.h"
#include "common/agent/weights.h"
#include "common/base/keyed_random.h"
#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::GoldenFrames;
using testing::GoldenWeights;
using testing::ReadGolden;

constexpr int kFrameBytes = 64 * 64 * 3;

std::unique_ptr<const Policy> GoldenPolicy(int tile) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  return *Policy::Create(spec, SaveWeights(spec, GoldenWeights(spec, ReadGolden("ppo_cnn.json"))), tile);
}

// Lanes and their frames, one after the other.
struct LaneFrames {
  std::vector<int> lanes;
  std::string frames;
};

// Lane l's frame is the l-th of the goldens' generator.
LaneFrames FramesOf(const std::vector<int>& lanes, uint32_t seed) {
  const std::string all = GoldenFrames(seed, *std::max_element(lanes.begin(), lanes.end()) + 1, 64);
  LaneFrames result{lanes, ""};
  for (const int lane : lanes) result.frames += all.substr(static_cast<size_t>(lane) * kFrameBytes, kFrameBytes);
  return result;
}

ActResult ActOn(const Policy& policy, const LaneFrames& input) {
  std::vector<double> noise;
  for (const int lane : input.lanes) noise.push_back(ActionNoise(1, lane, 0));
  return *policy.Act(input.frames, input.lanes, noise, {});
}

TEST(Policy, GreedyActionsAndValuesMatchTheGolden) {
  const nlohmann::json golden = ReadGolden("ppo_cnn.json");
  const std::string frames = GoldenFrames(golden["frames"]["seed"], golden["frames"]["n"], 64);
  const ActResult result = *GoldenPolicy(8)->ActGreedily(frames, {0, 1, 2, 3}, {});
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(static_cast<int>(result.actions[i]), golden["forward"]["greedy_actions"][i].get<int>());
    EXPECT_NEAR(result.log_probs[i], golden["forward"]["greedy_log_prob"][i].get<double>(), 1e-5);
    EXPECT_NEAR(result.values[i], golden["forward"]["values"][i].get<double>(), 1e-5);
  }
}

TEST(Policy, ActionsOfALaneDoNotDependOnOtherLanes) {
  const auto policy = GoldenPolicy(8);
  const std::vector<int> all_lanes = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  const ActResult all = ActOn(*policy, FramesOf(all_lanes, 12345));
  const std::vector<std::vector<int>> subsets = {
      {0}, {7}, {15}, {3, 11}, {11, 3}, {9, 1, 4, 12, 0}, {15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0}};
  for (const std::vector<int>& lanes : subsets) {
    const LaneFrames input = FramesOf(lanes, 12345);
    const ActResult some = ActOn(*policy, input);
    EXPECT_EQ(*policy->Values(input.frames, input.lanes, {}), some.values);
    for (size_t i = 0; i < lanes.size(); ++i) {
      EXPECT_EQ(some.actions[i], all.actions[lanes[i]]) << lanes[i];
      EXPECT_EQ(some.log_probs[i], all.log_probs[lanes[i]]) << lanes[i];
      EXPECT_EQ(some.values[i], all.values[lanes[i]]) << lanes[i];
    }
  }
}

TEST(Policy, ActionsOfALaneDoNotDependOnOtherFrames) {
  const auto policy = GoldenPolicy(8);
  LaneFrames input = FramesOf({0, 1, 2, 3, 4, 5, 6, 7}, 12345);
  const ActResult before = ActOn(*policy, input);
  const std::string others = GoldenFrames(99, 8, 64);
  for (int lane = 0; lane < 8; ++lane) {
    LaneFrames changed = input;
    for (int other = 0; other < 8; ++other) {
      if (other == lane) continue;
      changed.frames.replace(other * kFrameBytes, kFrameBytes, others, other * kFrameBytes, kFrameBytes);
    }
    const ActResult after = ActOn(*policy, changed);
    EXPECT_EQ(after.log_probs[lane], before.log_probs[lane]);
    EXPECT_EQ(after.values[lane], before.values[lane]);
    EXPECT_NE(after.values[(lane + 1) % 8], before.values[(lane + 1) % 8]);
  }
}

TEST(Policy, ALaneMayOccurMoreThanOnce) {
  const auto policy = GoldenPolicy(4);
  const std::string frames = GoldenFrames(1, 3, 64);
  const std::vector<float> together = *policy->Values(frames, {2, 2, 2}, {});
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ((*policy->Values(absl::string_view(frames).substr(i * kFrameBytes, kFrameBytes), {2}, {}))[0],
              together[i]);
  }
}

TEST(Policy, ActionsAreSampledByTheirProbability) {
  const auto policy = GoldenPolicy(1);
  const std::string frame = GoldenFrames(12345, 1, 64);
  const nlohmann::json log_probs = ReadGolden("ppo_cnn.json")["forward"]["log_softmax"][0];
  double cumulative = 0;
  for (int action = 0; action < kNumActions; ++action) {
    const double probability = std::exp(log_probs[action].get<double>());
    const ActResult result = *policy->Act(frame, {0}, {cumulative + probability / 2}, {});
    EXPECT_EQ(static_cast<int>(result.actions[0]), action);
    EXPECT_NEAR(result.log_probs[0], log_probs[action].get<double>(), 1e-5);
    cumulative += probability;
  }
}

TEST(Policy, ThreadsThatShareAPolicyGetTheSameActions) {
  const auto policy = GoldenPolicy(8);
  const LaneFrames input = FramesOf({0, 1, 2, 3, 4, 5, 6, 7}, 12345);
  const std::vector<float> expected = *policy->Values(input.frames, input.lanes, {});
  std::vector<std::vector<float>> results(3);
  std::vector<std::thread> threads;
  threads.reserve(results.size());
  for (std::vector<float>& result : results) {
    threads.emplace_back([&] { result = *policy->Values(input.frames, input.lanes, {}); });
  }
  for (std::thread& thread : threads) thread.join();
  for (const std::vector<float>& result : results) EXPECT_EQ(result, expected);
}

TEST(Policy, NoLanesGiveNoActions) {
  const ActResult result = *GoldenPolicy(8)->Act("", {}, {}, {});
  EXPECT_TRUE(result.actions.empty());
}

std::unique_ptr<const Policy> RecurrentPolicy(int tile) {
  const testing::GoldenAgent agent("lstm_cnn");
  return *Policy::Create(agent.spec, SaveWeights(agent.spec, agent.weights), tile);
}

TEST(Policy, RecurrentStatesAdvanceInActButNotInValues) {
  const auto policy = RecurrentPolicy(4);
  ASSERT_EQ(policy->state_size(), 512);
  const std::string frames = GoldenFrames(1, 2, 64);
  std::vector<float> states(2 * 512);
  const std::vector<float> zeros = states;
  const std::vector<float> values = *policy->Values(frames, {0, 1}, states);
  EXPECT_EQ(states, zeros);
  const ActResult first = *policy->Act(frames, {0, 1}, {0.5, 0.5}, absl::MakeSpan(states));
  EXPECT_EQ(first.values, values);
  EXPECT_NE(states, zeros);
  std::vector<float> greedy_states = zeros;
  ASSERT_TRUE(policy->ActGreedily(frames, {0, 1}, absl::MakeSpan(greedy_states)).ok());
  EXPECT_EQ(greedy_states, states);
  const ActResult second = *policy->Act(frames, {0, 1}, {0.5, 0.5}, absl::MakeSpan(states));
  EXPECT_NE(second.log_probs, first.log_probs);  // the same frames, another state
}

TEST(Policy, RecurrentActionsOfALaneDoNotDependOnOtherLanes) {
  const auto policy = RecurrentPolicy(4);
  const LaneFrames input = FramesOf({0, 1, 2, 3, 4, 5}, 12345);
  std::vector<float> states = testing::GoldenUniforms("h0", 6 * 512, -1, 1);
  const std::vector<float> before = states;
  const std::vector<double> noise(6, 0.3);
  const ActResult all = *policy->Act(input.frames, input.lanes, noise, absl::MakeSpan(states));
  for (const int lane : input.lanes) {
    std::vector<float> alone(before.begin() + lane * 512, before.begin() + (lane + 1) * 512);
    const ActResult result =
        *policy->Act(input.frames.substr(lane * kFrameBytes, kFrameBytes), {lane}, {0.3}, absl::MakeSpan(alone));
    EXPECT_EQ(result.log_probs[0], all.log_probs[lane]) << lane;
    EXPECT_EQ(result.values[0], all.values[lane]) << lane;
    EXPECT_TRUE(std::equal(alone.begin(), alone.end(), states.begin() + lane * 512)) << lane;
  }
}

// The same for the parts that the small agents lack.
TEST(Policy, AttentionValuesOfALaneDoNotDependOnOtherLanes) {
  for (const char* const name : {"oc_sa", "oc_ca", "ppo_resnet", "grid_distillation"}) {
    const AgentSpec spec = *FindAgent(name);
    const auto policy = *Policy::Create(spec, SaveWeights(spec, InitialWeights(spec, 1)), 4);
    const std::string frames = GoldenFrames(12345, 3, spec.frame_size);
    const std::vector<float> state(spec.state_size, 0.5F);
    const std::vector<float> states(3 * state.size(), 0.5F);
    const std::vector<float> all = *policy->Values(frames, {0, 1, 2}, states);
    for (int lane = 0; lane < 3; ++lane) {
      const std::string frame = frames.substr(lane * spec.frame_bytes(), spec.frame_bytes());
      EXPECT_EQ((*policy->Values(frame, {lane}, state))[0], all[lane]) << name << " " << lane;
    }
  }
}

// Of the network `text` with initial weights, in tiles of 4.
std::unique_ptr<const Policy> SmallPolicy(const std::string& text, const std::string& device) {
  v1::RunConfig config;
  EXPECT_TRUE(google::protobuf::TextFormat::ParseFromString(text, &config)) << text;
  const AgentSpec spec = *MakeAgentSpec(config);
  return *Policy::Create(spec, SaveWeights(spec, InitialWeights(spec, 1)), 4, device);
}

// The device multiplies in other routines and orders than the CPU's nets: float32's last bits differ.
TEST(Policy, ActsOnADeviceAsOnTheCpu) {
  for (const char* text :
       {R"(agent: "ppo_cnn" network { frame_size: 40 })",
        R"(agent: "lstm_cnn" network { frame_size: 40 critic: LSTM })",
        R"(agent: "ppo_spcnn" network { frame_size: 12 })", R"(agent: "oc_sa" network { frame_size: 20 })",
        R"(agent: "oc_ca" network { frame_size: 32 })", R"(agent: "ppo_resnet" network { frame_size: 12 })",
        R"(agent: "achievement_distillation" network { extractor: CNN frame_size: 40 })",
        R"(agent: "grid_distillation" network { frame_size: 20 })"}) {
    const auto here = SmallPolicy(text, "cpu");
    for (const std::string device : {"cpu:0", testing::kStandInDevice}) {
      const auto there = SmallPolicy(text, device);
      v1::RunConfig config;
      ASSERT_TRUE(google::protobuf::TextFormat::ParseFromString(text, &config));
      const int size = MakeAgentSpec(config)->frame_size;
      const std::string frames = GoldenFrames(12345, 5, size);
      const std::vector<int> lanes = {0, 1, 2, 3, 5};  // two tiles
      const std::vector<double> noise(5, 0.3);
      std::vector<float> states = testing::GoldenUniforms("h0", 5 * here->state_size(), -1, 1);
      std::vector<float> states_there = states;
      const ActResult expected = *here->Act(frames, lanes, noise, absl::MakeSpan(states));
      const testing::DeviceTraffic before = testing::TrafficSoFar();
      const ActResult actual = *there->Act(frames, lanes, noise, absl::MakeSpan(states_there));
      const testing::DeviceTraffic after = testing::TrafficSoFar();
      if (device == testing::kStandInDevice) {
        EXPECT_EQ(after.sent - before.sent, 2 * (here->state_size() > 0 ? 2 : 1)) << text;
        EXPECT_EQ(after.fetched - before.fetched, 2) << text;
        EXPECT_EQ(after.read - before.read, 0) << text;
      }
      EXPECT_EQ(actual.actions, expected.actions) << text << device;
      for (int i = 0; i < 5; ++i) {
        EXPECT_NEAR(actual.log_probs[i], expected.log_probs[i], 1e-4) << text << device;
        EXPECT_NEAR(actual.values[i], expected.values[i], 1e-4) << text << device;
      }
      for (size_t i = 0; i < states.size(); ++i) ASSERT_NEAR(states_there[i], states[i], 1e-4) << text << device;
      // Alone in its tile, a lane gets the same.
      std::vector<float> alone = testing::GoldenUniforms("h0", 5 * here->state_size(), -1, 1);
      const auto size_of_state = here->state_size();
      const std::string frame = frames.substr(2 * size * size * 3, size * size * 3);
      const auto state = absl::MakeSpan(alone).subspan(2 * size_of_state, size_of_state);
      EXPECT_EQ(there->Act(frame, {2}, {0.3}, state)->values[0], actual.values[2]) << text << device;
    }
  }
}

TEST(Policy, RemembersOnADeviceAsOnTheCpu) {
  const std::string text = R"(agent: "achievement_distillation" network { extractor: CNN frame_size: 40 })";
  const auto here = SmallPolicy(text, "cpu");
  const std::vector<int> lanes = {0, 1, 2, 3, 5};  // two tiles
  const std::string before = GoldenFrames(1, 5, 40);
  const std::string after = GoldenFrames(2, 5, 40);
  std::vector<float> expected(5 * here->state_size());
  ASSERT_THAT(here->Remember(before, after, lanes, absl::MakeSpan(expected)), IsOk());
  for (const std::string device : {"cpu:0", testing::kStandInDevice}) {
    std::vector<float> actual(expected.size());
    ASSERT_THAT(SmallPolicy(text, device)->Remember(before, after, lanes, absl::MakeSpan(actual)), IsOk());
    for (size_t i = 0; i < actual.size(); ++i) ASSERT_NEAR(actual[i], expected[i], 1e-4) << device;
  }
}

TEST(Policy, RefusesStatesOfAnotherSize) {
  std::vector<float> states(512);
  EXPECT_THAT(std::string(RecurrentPolicy(4)->Act(GoldenFrames(1, 1, 64), {0}, {0.5}, {}).status().message()),
              ::testing::HasSubstr("0 floats of recurrent state for 1 lanes, want 512 a lane"));
  EXPECT_EQ(GoldenPolicy(4)->Act(GoldenFrames(1, 1, 64), {0}, {0.5}, absl::MakeSpan(states)).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(Policy, RefusesInconsistentInputs) {
  const auto policy = GoldenPolicy(8);
  EXPECT_EQ(policy->Act(std::string(kFrameBytes, 0), {0}, {}, {}).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(policy->Values(std::string(100, 0), {0}, {}).status().message()),
              ::testing::HasSubstr("12288"));
  const AgentSpec spec = *FindAgent("ppo_cnn");
  EXPECT_THAT(std::string(Policy::Create(spec, SaveWeights(spec, InitialWeights(spec, 1)), 0).status().message()),
              ::testing::HasSubstr("tile is 0"));
  EXPECT_EQ(Policy::Create(spec, "rubbish", 8).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(Policy, WeightsThatAreNotFiniteAreAnError) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  std::vector<float> weights = InitialWeights(spec, 1);
  weights.back() = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(Policy::Create(spec, SaveWeights(spec, weights), 1).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(Policy, OutputsThatAreNotFiniteAreAnError) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  const std::vector<float> weights(InitialWeights(spec, 1).size(), 1e30F);
  const auto policy = *Policy::Create(spec, SaveWeights(spec, weights), 1);
  EXPECT_EQ(policy->Values(std::string(kFrameBytes, 0), {0}, {}).status().code(), absl::StatusCode::kInternal);
}

}  // namespace
}  // namespace craftfleet
