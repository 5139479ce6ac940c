#include "common/agent/policy.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <set>
#include <string>
#include <thread>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "common/agent/aligned_weights.h"
#include "common/agent/device_snapshot.h"
#include "common/agent/initial_weights.h"
#include "common/agent/policy_net.h"
#include "common/agent/weights.h"
#include "common/base/keyed_random.h"
#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr int kFrameBytes = 64 * 64 * 3;

std::unique_ptr<const Policy> GoldenPolicy(int tile) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  return *Policy::Create(spec, SaveWeights(spec, GoldenWeights(spec, ReadGolden("ppo_cnn.json"))), tile);
}

std::unique_ptr<const Policy> InitialPolicy(const AgentSpec& spec, int tile) {
  return *Policy::Create(spec, SaveWeights(spec, InitialWeights(spec, 1)), tile);
}

TEST(Policy, GreedyActionsAndValuesMatchTheGolden) {
  const nlohmann::json golden = ReadGolden("ppo_cnn.json");
  const std::string frames = GoldenFrames(golden["frames"]["seed"], golden["frames"]["n"], 64);
  const ActResult result = *GoldenPolicy(8)->Act(frames, {0, 1, 2, 3}, /*noise=*/{}, {});
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(static_cast<int>(result.actions[i]), golden["forward"]["greedy_actions"][i].get<int>());
    EXPECT_NEAR(result.log_probs[i], golden["forward"]["greedy_log_prob"][i].get<double>(), 1e-5);
    EXPECT_NEAR(result.values[i], golden["forward"]["values"][i].get<double>(), 1e-5);
  }
}

// Some lanes of an agent's policy, in tiles of 4, each with a frame, a state and noise of its own.
class PolicyOfLanes : public testing::TestWithParam<const char*> {
 protected:
  static constexpr int kLanes = 6;

  // What acting gives each of `lanes`: log-probability, value, action and the state after it.
  std::vector<std::vector<float>> Act(const std::vector<int>& lanes, const std::string& frames) const {
    std::string input;
    std::vector<float> states;
    std::vector<double> noise;
    for (const int lane : lanes) {
      input += frames.substr(lane * spec_.frame_bytes(), spec_.frame_bytes());
      states.insert(states.end(), states_.begin() + lane * size_, states_.begin() + (lane + 1) * size_);
      noise.push_back(ActionNoise(1, lane, 0));
    }
    const std::vector<float> values = *policy_->Values(input, lanes, states);
    const ActResult acted = *policy_->Act(input, lanes, noise, absl::MakeSpan(states));
    EXPECT_EQ(acted.values, values);
    std::vector<std::vector<float>> results;
    for (size_t i = 0; i < lanes.size(); ++i) {
      results.emplace_back(states.begin() + i * size_, states.begin() + (i + 1) * size_);
      for (const float x : {acted.log_probs[i], acted.values[i], static_cast<float>(acted.actions[i])}) {
        results.back().push_back(x);
      }
    }
    return results;
  }

  const AgentSpec spec_ = *FindAgent(GetParam());
  const int64_t size_ = spec_.state_size;
  const std::unique_ptr<const Policy> policy_ = InitialPolicy(spec_, 4);
  const std::vector<float> states_ = GoldenUniforms("h0", int64_t{kLanes} * size_, -1, 1);
  const std::string frames_ = GoldenFrames(12345, kLanes, spec_.frame_size);
};

TEST_P(PolicyOfLanes, DoesNotDependOnOtherLanesNorOnTheirFrames) {
  const auto all = Act({0, 1, 2, 3, 4, 5}, frames_);
  for (const std::vector<int>& lanes : std::vector<std::vector<int>>{{0}, {5}, {3, 1}, {5, 4, 3, 2, 1, 0}, {2, 2, 2}}) {
    const auto some = Act(lanes, frames_);
    for (size_t i = 0; i < lanes.size(); ++i) EXPECT_EQ(some[i], all[lanes[i]]) << lanes[i];
  }
  std::string changed = GoldenFrames(99, kLanes, spec_.frame_size);
  changed.replace(2 * spec_.frame_bytes(), spec_.frame_bytes(), frames_, 2 * spec_.frame_bytes(), spec_.frame_bytes());
  const auto others = Act({0, 1, 2, 3, 4, 5}, changed);
  EXPECT_EQ(others[2], all[2]);
  EXPECT_NE(others[1], all[1]);
}

INSTANTIATE_TEST_SUITE_P(Agents, PolicyOfLanes,
                         testing::Values("ppo_cnn", "lstm_cnn", "oc_sa", "oc_ca", "ppo_resnet", "grid_distillation"),
                         [](const auto& info) { return std::string(info.param); });

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
  const std::string frames = GoldenFrames(12345, 8, 64);
  const std::vector<int> lanes = {0, 1, 2, 3, 4, 5, 6, 7};
  const std::vector<float> expected = *policy->Values(frames, lanes, {});
  std::vector<std::vector<float>> results(3);
  std::vector<std::thread> threads;
  threads.reserve(results.size());
  for (std::vector<float>& result : results) {
    threads.emplace_back([&] { result = *policy->Values(frames, lanes, {}); });
  }
  for (std::thread& thread : threads) thread.join();
  for (const std::vector<float>& result : results) EXPECT_EQ(result, expected);
}

TEST(Policy, NoLanesGiveNoActions) {
  const ActResult result = *GoldenPolicy(8)->Act("", {}, {}, {});
  EXPECT_TRUE(result.actions.empty());
}

std::unique_ptr<const Policy> RecurrentPolicy(int tile) {
  const GoldenAgent agent("lstm_cnn");
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
  ASSERT_TRUE(policy->Act(frames, {0, 1}, /*noise=*/{}, absl::MakeSpan(greedy_states)).ok());
  EXPECT_EQ(greedy_states, states);
  const ActResult second = *policy->Act(frames, {0, 1}, {0.5, 0.5}, absl::MakeSpan(states));
  EXPECT_NE(second.log_probs, first.log_probs);  // the same frames, another state
}

AgentSpec SpecOf(const std::string& text) {
  v1::RunConfig config;
  EXPECT_TRUE(google::protobuf::TextFormat::ParseFromString(text, &config)) << text;
  return *MakeAgentSpec(config);
}

// The device multiplies in other routines and orders than the CPU's nets: float32's last bits differ.
TEST(Policy, ActsOnADeviceAsOnTheCpu) {
  for (const std::string text :
       {R"(agent: "ppo_cnn" network { frame_size: 40 })",
        R"(agent: "lstm_cnn" network { frame_size: 40 critic: LSTM })",
        R"(agent: "ppo_spcnn" network { frame_size: 12 })", R"(agent: "oc_sa" network { frame_size: 20 })",
        R"(agent: "oc_ca" network { frame_size: 32 })", R"(agent: "ppo_resnet" network { frame_size: 12 })",
        R"(agent: "achievement_distillation" network { extractor: CNN frame_size: 40 })",
        R"(agent: "grid_distillation" network { frame_size: 20 })"}) {
    const AgentSpec spec = SpecOf(text);
    const std::string weights = SaveWeights(spec, InitialWeights(spec, 1));
    const auto here = *Policy::Create(spec, weights, 4);
    const std::string frames = GoldenFrames(12345, 5, spec.frame_size);
    const std::vector<int> lanes = {0, 1, 2, 3, 5};  // two tiles
    const std::vector<double> noise(5, 0.3);
    const std::vector<float> before = GoldenUniforms("h0", 5 * spec.state_size, -1, 1);
    std::vector<float> states = before;
    const ActResult expected = *here->Act(frames, lanes, noise, absl::MakeSpan(states));
    for (const std::string device : {"cpu:0", kStandInDevice}) {
      SCOPED_TRACE(text + device);
      const auto there = *Policy::Create(spec, weights, 4, device);
      std::vector<float> states_there = before;
      const ActResult actual = *there->Act(frames, lanes, noise, absl::MakeSpan(states_there));
      EXPECT_EQ(actual.actions, expected.actions);
      for (int i = 0; i < 5; ++i) {
        EXPECT_NEAR(actual.log_probs[i], expected.log_probs[i], 1e-4);
        EXPECT_NEAR(actual.values[i], expected.values[i], 1e-4);
      }
      for (size_t i = 0; i < states.size(); ++i) ASSERT_NEAR(states_there[i], states[i], 1e-4);
      // Alone in its tile, a lane gets the same.
      std::vector<float> alone = before;
      const std::string frame = frames.substr(2 * spec.frame_bytes(), spec.frame_bytes());
      const auto state = absl::MakeSpan(alone).subspan(2 * spec.state_size, spec.state_size);
      EXPECT_EQ(there->Act(frame, {2}, {0.3}, state)->values[0], actual.values[2]);
    }
  }
}

TEST(Policy, LooksIntoASnapshotOnItsDevice) {
  const at::Device stand_in(kStandInDevice);
  for (const std::string text :
       {R"(agent: "lstm_cnn" network { frame_size: 40 })", R"(agent: "oc_sa" network { frame_size: 20 })",
        R"(agent: "ppo_cnn" network { frame_size: 40 } precision: BF16)"}) {
    const AgentSpec spec = SpecOf(text);
    const std::vector<float> values = InitialWeights(spec, 1);
    const std::string bytes = SaveWeights(spec, values);
    const std::string frames = GoldenFrames(12345, 2, spec.frame_size);
    const std::vector<double> noise(2, 0.3);
    SCOPED_TRACE(text);
    const auto snapshot = std::make_shared<const DeviceSnapshot>(spec, SendFloats(Align(spec, values), stand_in));
    EXPECT_EQ(**snapshot->Bytes(), bytes);
    const int64_t sent = TrafficSoFar().sent;
    const auto looking = *Policy::Create(spec, snapshot, 4, kStandInDevice);
    EXPECT_EQ(TrafficSoFar().sent - sent, spec.state_size > 0 ? 4 : 0) << "a recurrent agent's order of rows";
    const auto copying = *Policy::Create(spec, bytes, 4, kStandInDevice);
    std::vector<float> states(2 * spec.state_size);
    std::vector<float> expected_states(2 * spec.state_size);
    const ActResult expected = *copying->Act(frames, {0, 1}, noise, absl::MakeSpan(expected_states));
    EXPECT_EQ(looking->Act(frames, {0, 1}, noise, absl::MakeSpan(states))->values, expected.values);
    EXPECT_EQ(states, expected_states);
    EXPECT_THAT(Policy::Create(spec, snapshot, 0, kStandInDevice),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("tile is 0")));
    if (spec.precision == v1::RunConfig::BF16) continue;  // not every CPU has it
    std::fill(states.begin(), states.end(), 0.0F);
    const auto here = *Policy::Create(spec, snapshot, 4);
    EXPECT_NEAR(here->Act(frames, {0, 1}, noise, absl::MakeSpan(states))->values[0], expected.values[0], 1e-4);
  }
}

// As an actor's threads do beside an update.
TEST(Policy, ActsOnAStreamOfItsOwnWhereTheRunWantsIt) {
  const at::Device stand_in(kStandInDevice);
  for (const bool wanted : {false, true}) {
    SCOPED_TRACE(wanted);
    const AgentSpec spec = SpecOf(
        absl::StrCat(R"(agent: "lstm_cnn" network { frame_size: 40 } acting_stream: )", wanted ? "true" : "false"));
    const std::vector<float> values = InitialWeights(spec, 1);
    const auto snapshot = std::make_shared<const DeviceSnapshot>(spec, SendFloats(Align(spec, values), stand_in));
    const auto current = [&] { return CurrentStream(stand_in).id(); };
    std::set<int64_t> streams;
    ObserveComputations([&](auto&&...) { streams.insert(current()); });
    const int64_t awaited = TrafficSoFar().awaited;
    const auto policy = *Policy::Create(spec, snapshot, 4, kStandInDevice);
    EXPECT_EQ(TrafficSoFar().awaited - awaited, wanted ? 1 : 0) << "for the weights to be there";
    std::vector<float> states(spec.state_size);
    const std::string frame = GoldenFrames(12345, 1, spec.frame_size);
    EXPECT_THAT(policy->Act(frame, {0}, {0.3}, absl::MakeSpan(states)), IsOk());
    const auto other = *Policy::Create(spec, SaveWeights(spec, values), 4, kStandInDevice);
    EXPECT_THAT(other->Act(frame, {0}, {0.3}, absl::MakeSpan(states)), IsOk());
    ObserveComputations(nullptr);
    EXPECT_THAT(streams, ElementsAre(wanted ? kOtherStream : 0));
    EXPECT_EQ(current(), 0) << "for updates of the same thread";
  }
}

TEST(Policy, RemembersOnADeviceAsOnTheCpu) {
  const AgentSpec spec = SpecOf(R"(agent: "achievement_distillation" network { extractor: CNN frame_size: 40 })");
  const std::string weights = SaveWeights(spec, InitialWeights(spec, 1));
  const auto here = *Policy::Create(spec, weights, 4);
  const std::vector<int> lanes = {0, 1, 2, 3, 5};  // two tiles
  const std::string before = GoldenFrames(1, 5, 40);
  const std::string after = GoldenFrames(2, 5, 40);
  std::vector<float> expected(5 * here->state_size());
  ASSERT_THAT(here->Remember(before, after, lanes, absl::MakeSpan(expected)), IsOk());
  for (const std::string device : {"cpu:0", kStandInDevice}) {
    std::vector<float> actual(expected.size());
    const auto there = *Policy::Create(spec, weights, 4, device);
    ASSERT_THAT(there->Remember(before, after, lanes, absl::MakeSpan(actual)), IsOk());
    for (size_t i = 0; i < actual.size(); ++i) ASSERT_NEAR(actual[i], expected[i], 1e-4) << device;
  }
}

TEST(Policy, RefusesStatesOfAnotherSize) {
  std::vector<float> states(512);
  EXPECT_THAT(std::string(RecurrentPolicy(4)->Act(GoldenFrames(1, 1, 64), {0}, {0.5}, {}).status().message()),
              testing::HasSubstr("0 floats of recurrent state for 1 lanes, want 512 a lane"));
  EXPECT_EQ(GoldenPolicy(4)->Act(GoldenFrames(1, 1, 64), {0}, {0.5}, absl::MakeSpan(states)).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(Policy, RefusesInconsistentInputs) {
  const auto policy = GoldenPolicy(8);
  EXPECT_EQ(policy->Act(std::string(kFrameBytes, 0), {0}, {0.5, 0.5}, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(policy->Values(std::string(100, 0), {0}, {}).status().message()),
              testing::HasSubstr("12288"));
  const AgentSpec spec = *FindAgent("ppo_cnn");
  const std::vector<float> zeros(spec.param_count);
  EXPECT_THAT(std::string(Policy::Create(spec, SaveWeights(spec, zeros), 0).status().message()),
              testing::HasSubstr("tile is 0"));
  EXPECT_EQ(Policy::Create(spec, "rubbish", 8).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(Policy, WeightsThatAreNotFiniteAreAnError) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  std::vector<float> weights(spec.param_count);
  weights.back() = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(Policy::Create(spec, SaveWeights(spec, weights), 1).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(Policy, OutputsThatAreNotFiniteAreAnError) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  const std::vector<float> weights(spec.param_count, 1e30F);
  const auto policy = *Policy::Create(spec, SaveWeights(spec, weights), 1);
  EXPECT_EQ(policy->Values(std::string(kFrameBytes, 0), {0}, {}).status().code(), absl::StatusCode::kInternal);
}

}  // namespace
}  // namespace craftfleet
