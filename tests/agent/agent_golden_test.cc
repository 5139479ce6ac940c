// Parameters, outputs and sequences of all six agents as published, against the goldens in tests/data/agents.

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "common/agent/categorical.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

constexpr double kOutput = 1e-5;  // the goldens were computed with another convolution implementation

void ExpectNear(const at::Tensor& actual, const nlohmann::json& expected, double tolerance, const std::string& what) {
  const auto values = expected.get<std::vector<double>>();
  ASSERT_LE(static_cast<int64_t>(values.size()), actual.numel()) << what;
  const at::Tensor flat = actual.contiguous().flatten();
  for (size_t i = 0; i < values.size(); ++i) {
    EXPECT_NEAR(flat.data_ptr<float>()[i], values[i], tolerance) << what << " " << i;
  }
}

// Compares logits, log-probabilities, entropy and greedy actions of each row, as far as `golden` has them.
void ExpectDistributions(const at::Tensor& logits, const nlohmann::json& golden) {
  const auto actions = golden["actions"].get<std::vector<int>>();
  const char* const log_prob_key = golden.contains("log_prob") ? "log_prob" : "log_prob_of_actions";
  for (size_t row = 0; row < actions.size(); ++row) {
    const Categorical odds(logits.data_ptr<float>() + row * kNumActions);
    EXPECT_NEAR(odds.Entropy(), golden["entropy"][row].get<double>(), kOutput) << row;
    EXPECT_NEAR(odds.log_probs[actions[row]], golden[log_prob_key][row].get<double>(), kOutput) << row;
    for (int i = 0; i < kNumActions; ++i) {
      EXPECT_NEAR(odds.log_probs[i], golden["log_softmax"][row][i].get<double>(), kOutput) << row << " " << i;
    }
    if (!golden.contains("greedy_actions")) continue;
    ExpectNear(logits[static_cast<int64_t>(row)], golden["logits_raw"][row], kOutput, "logits");
    EXPECT_EQ(static_cast<int>(odds.Greedy()), golden["greedy_actions"][row].get<int>()) << row;
    EXPECT_NEAR(odds.log_probs[static_cast<int>(odds.Greedy())], golden["greedy_log_prob"][row].get<double>(), kOutput);
  }
}

class AgentGolden : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override { SetUpTorchThread(); }
  void ExpectParameters() const;
  void ExpectFrames() const;
  void ExpectForward();
  void ExpectFeatures();
  void ExpectSequenceWithResets();

  GoldenAgent agent_{GetParam()};
  const AgentSpec& spec_ = agent_.spec;
  const nlohmann::json& golden_ = agent_.golden;
};

void AgentGolden::ExpectParameters() const {
  EXPECT_EQ(spec_.param_count, golden_["param_count"]);
  EXPECT_EQ(spec_.frame_size, golden_["frame_size"]);
  ASSERT_EQ(spec_.params.size(), golden_["params"].size());
  for (size_t p = 0; p < spec_.params.size(); ++p) {
    const ParamSpec& param = spec_.params[p];
    const nlohmann::json& expected = golden_["params"][p];
    EXPECT_EQ(param.name, expected["name"]);
    EXPECT_EQ(param.shape, expected["shape"].get<std::vector<int64_t>>()) << param.name;
    const float* values = &agent_.weights[param.offset];
    for (size_t i = 0; i < expected["first3"].size(); ++i) EXPECT_EQ(values[i], expected["first3"][i].get<float>());
    double sum = 0;
    for (int64_t i = 0; i < param.size; ++i) sum += values[i];
    EXPECT_NEAR(sum, expected["sum"].get<double>(), 1e-6) << param.name;
  }
}

void AgentGolden::ExpectFrames() const {
  const nlohmann::json& expected = golden_["frames"];
  const int size = spec_.frame_size;
  const std::string frames = GoldenFrames(expected["seed"], expected["n"], size);
  EXPECT_EQ(ByteSum(frames), expected["byte_sum"]);
  const size_t pixel = ((size_t{3} * size + 10) * size + 20) * 3;
  for (int channel = 0; channel < 3; ++channel) {
    EXPECT_EQ(static_cast<unsigned char>(frames[pixel + channel]), expected["pixel_n3_y10_x20"][channel]);
  }
}

// h and c of four lanes; the second one begins an episode.
at::Tensor ForwardStates() {
  const std::vector<float> h = GoldenUniforms("h0", 1024, -0.5, 0.5);
  const std::vector<float> c = GoldenUniforms("c0", 1024, -1, 1);
  const at::Tensor states = at::cat({at::tensor(h).view({4, 256}), at::tensor(c).view({4, 256})}, 1);
  states[1].zero_();
  return states;
}

void AgentGolden::ExpectForward() {
  const nlohmann::json& forward = golden_["forward"];
  const at::Tensor input = AsInput(GoldenFrames(golden_["frames"]["seed"], 4, spec_.frame_size), spec_);
  const Segments segments = {{1, 1, 1, 1}, spec_.state_size > 0 ? ForwardStates() : at::Tensor()};
  for (const PolicyNet::Use use : {PolicyNet::Use::kActing, PolicyNet::Use::kTraining}) {
    const PolicyNet net(spec_, use, absl::MakeSpan(agent_.weights));
    const PolicyNet::Output output = net.Forward(input, segments);
    ExpectNear(output.values, forward["values"], kOutput, "values");
    ExpectDistributions(output.logits, forward);
    if (spec_.state_size == 0) continue;
    for (int row = 0; row < 4; ++row) {
      const auto [h, c] = std::pair(output.states[row].narrow(0, 0, 256), output.states[row].narrow(0, 256, 256));
      ExpectNear(h, forward["h1_first4"][row], kOutput, "h");
      ExpectNear(c, forward["c1_first4"][row], kOutput, "c");
      EXPECT_NEAR(h.norm().item<float>(), forward["h1_l2"][row].get<double>(), 1e-4);
      EXPECT_NEAR(c.norm().item<float>(), forward["c1_l2"][row].get<double>(), 1e-4);
    }
  }
}

void AgentGolden::ExpectFeatures() {
  const nlohmann::json& forward = golden_["forward"];
  ParamList params;
  const Network network(spec_.network, &params);
  ParamTensors tensors;
  for (const ParamSpec& param : params.specs()) {
    tensors.tensors.push_back(at::from_blob(agent_.weights.data() + param.offset, param.shape));
  }
  const at::Tensor input = AsInput(GoldenFrames(golden_["frames"]["seed"], 4, spec_.frame_size), spec_);
  const at::Tensor features = network.Features(tensors, input, std::nullopt);
  for (int row = 0; row < 4; ++row) {
    ExpectNear(features[row], forward["features_first8"][row], kOutput, "features");
    EXPECT_NEAR(features[row].norm().item<float>(), forward["features_l2"][row].get<double>(), 1e-4);
  }
}

// A fragment of 16 steps in which episodes begin at 5 and 11: three segments; only the first starts with a state.
void AgentGolden::ExpectSequenceWithResets() {
  const nlohmann::json& sequence = golden_["sequence16"];
  const std::string frames = GoldenFrames(sequence["frames_seed"], sequence["T"], spec_.frame_size);
  ASSERT_EQ(ByteSum(frames), sequence["frames_byte_sum"]);
  std::vector<int> lengths = {0};
  for (const double is_start : sequence["episode_starts"]) {
    if (is_start == 1) lengths.push_back(0);
    ++lengths.back();
  }
  ASSERT_EQ(lengths, (std::vector<int>{5, 6, 5}));
  const at::Tensor states = at::zeros({3, 512});
  states[0].narrow(0, 0, 256).copy_(at::tensor(GoldenUniforms("seq_h0", 256, -0.5, 0.5)));
  states[0].narrow(0, 256, 256).copy_(at::tensor(GoldenUniforms("seq_c0", 256, -1, 1)));

  const PolicyNet net(spec_, PolicyNet::Use::kTraining, absl::MakeSpan(agent_.weights));
  const PolicyNet::Output output = net.Forward(AsInput(frames, spec_), {lengths, states});
  ExpectNear(output.values, sequence["values"], kOutput, "values");
  ExpectDistributions(output.logits, sequence);
  const at::Tensor h = output.states[2].narrow(0, 0, 256);
  const at::Tensor c = output.states[2].narrow(0, 256, 256);
  ExpectNear(h, sequence["h_final_first8"], kOutput, "h");
  ExpectNear(c, sequence["c_final_first8"], kOutput, "c");
  EXPECT_NEAR(h.norm().item<float>(), sequence["h_final_l2"].get<double>(), 1e-4);
  EXPECT_NEAR(c.norm().item<float>(), sequence["c_final_l2"].get<double>(), 1e-4);
}

// One test, since making the weights takes longer than the checks.
TEST_P(AgentGolden, ParametersFramesAndOutputsMatch) {
  ExpectParameters();
  ExpectFrames();
  ExpectForward();
  ExpectFeatures();
  if (spec_.state_size > 0) ExpectSequenceWithResets();
}

INSTANTIATE_TEST_SUITE_P(All, AgentGolden,
                         testing::Values("ppo_cnn", "lstm_cnn", "ppo_spcnn", "lstm_spcnn", "oc_sa", "oc_ca"),
                         [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace craftfleet
