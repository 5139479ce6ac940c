// Parts of networks and whole networks: properties that the goldens do not cover.

#include "common/agent/nets/network.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/initial_weights.h"
#include "common/agent/nets/attention.h"
#include "common/agent/nets/self_attention.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"

namespace craftfleet {
namespace {

// The spec of `agent` with the changes that `network` makes.
AgentSpec SpecOf(const std::string& agent, const std::string& network) {
  v1::RunConfig config;
  config.set_agent(agent);
  EXPECT_TRUE(google::protobuf::TextFormat::ParseFromString(network, config.mutable_network())) << network;
  return *MakeAgentSpec(config);
}

// An agent with initial weights, and inputs for it.
struct Sample {
  Sample(const std::string& agent, const std::string& network, int rows)
      : spec(SpecOf(agent, network)),
        weights(InitialWeights(spec, 1)),
        net(spec, PolicyNet::Use::kTraining, absl::MakeSpan(weights)),
        input(AsInput(GoldenFrames(3, rows, spec.frame_size), spec)) {}

  AgentSpec spec;
  std::vector<float> weights;
  PolicyNet net;
  at::Tensor input;
};

TEST(AgentSpec, ParametersAreContiguous) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  int64_t offset = 0;
  for (const ParamSpec& param : spec.params) {
    EXPECT_EQ(param.offset, offset) << param.name;
    EXPECT_EQ(param.size, c10::multiply_integers(param.shape)) << param.name;
    offset += param.size;
  }
  EXPECT_EQ(offset, spec.param_count);
}

TEST(AgentSpec, AnLstmCriticHasParametersOfItsOwn) {
  const AgentSpec spec = SpecOf("lstm_cnn", "critic: LSTM");
  EXPECT_EQ(spec.params[12].name, "lstm_actor.weight_ih_l0");
  EXPECT_EQ(spec.params[16].name, "lstm_critic.weight_ih_l0");
  EXPECT_EQ(spec.params.size(), 20U);
}

class Ablation : public testing::TestWithParam<std::string> {};

TEST_P(Ablation, LearnsEveryParameterAndStartsNearlyUniform) {
  SetUpTorchThread();
  Sample sample("oc_ca", GetParam(), 2);
  const PolicyNet::Output output = sample.net.Forward(sample.input, {{2}, at::zeros({1, sample.spec.state_size})});
  ASSERT_EQ(output.logits.sizes(), (std::vector<int64_t>{2, 17}));
  EXPECT_LT(output.logits.abs().max().item<float>(), 0.5);
  torch::autograd::backward({output.logits.pow(2).sum() + output.values.sum()}, {});
  const std::vector<absl::Span<float>> gradients = sample.net.gradients();
  for (size_t p = 0; p < gradients.size(); ++p) {
    double squares = 0;
    for (const float x : gradients[p]) squares += double{x} * x;
    EXPECT_TRUE(std::isfinite(squares)) << sample.spec.params[p].name;
    EXPECT_GT(squares, 0) << sample.spec.params[p].name;
  }
}

constexpr char kSmall[] = " frame_size: 24 patch: 8 stride: 8";

INSTANTIATE_TEST_SUITE_P(OcCa, Ablation,
                         testing::Values(absl::StrCat("slots: 1", kSmall), absl::StrCat("slots: 16", kSmall),
                                         absl::StrCat("heads: 1", kSmall), absl::StrCat("heads: 16", kSmall),
                                         "frame_size: 24 patch: 1 stride: 1", kSmall,
                                         "frame_size: 24 patch: 12 stride: 8", "frame_size: 24 patch: 12 stride: 12",
                                         "frame_size: 24 patch: 16 stride: 8",
                                         absl::StrCat("residual_mlp: true", kSmall),
                                         absl::StrCat("layer_norm: true", kSmall),
                                         absl::StrCat("residual_mlp: true layer_norm: true", kSmall),
                                         absl::StrCat("slot_competition: true", kSmall), "frame_size: 64",
                                         absl::StrCat("recurrent: true critic: LINEAR", kSmall),
                                         absl::StrCat("recurrent: true critic: LSTM", kSmall)));

TEST(CutPatches, AreInRowOrderAndFlattenedByChannel) {
  // Value 100 c + 10 y + x of a 2-channel 5x5 map.
  const at::Tensor map = at::empty({1, 2, 5, 5});
  for (int c = 0; c < 2; ++c) {
    for (int y = 0; y < 5; ++y) {
      for (int x = 0; x < 5; ++x) map[0][c][y][x] = 100 * c + 10 * y + x;
    }
  }
  for (const char* device : {"cpu", kStandInDevice}) {
    const at::Tensor patches =
        CutPatches(map.to(at::Device(device)), 2, 2).cpu();  // the last row and column are left over
    ASSERT_EQ(patches.sizes(), (std::vector<int64_t>{1, 4, 8}));
    EXPECT_TRUE(patches[0][1].equal(at::tensor({2.F, 3.F, 12.F, 13.F, 102.F, 103.F, 112.F, 113.F})));
    EXPECT_TRUE(patches[0][2].equal(at::tensor({20.F, 21.F, 30.F, 31.F, 120.F, 121.F, 130.F, 131.F})));
  }
}

// Attention by its definition, computed number by number. `competition`: softmax over queries.
at::Tensor SlowAttention(const at::Tensor& q, const at::Tensor& k, const at::Tensor& v, int heads, bool competition) {
  const int64_t width = 256 / heads;
  at::Tensor out = at::zeros({k.size(0), q.size(0), 256});
  for (int64_t n = 0; n < k.size(0); ++n) {
    for (int head = 0; head < heads; ++head) {
      const auto part = [&](const at::Tensor& x) { return x.narrow(-1, head * width, width); };
      const at::Tensor scores = part(q).mm(part(k[n]).t()) / std::sqrt(static_cast<double>(width));
      at::Tensor weights = scores.exp() / scores.exp().sum(competition ? 0 : 1, true);
      if (competition) weights = weights / weights.sum(1, true);
      part(out[n]).copy_(weights.mm(part(v[n])));
    }
  }
  return out;
}

TEST(Attend, MatchesTheDefinition) {
  SetUpTorchThread();
  at::manual_seed(1);
  const at::Tensor q = at::randn({3, 256});
  const at::Tensor k = at::randn({2, 5, 256});
  const at::Tensor v = at::randn({2, 5, 256});
  for (const int heads : {1, 4, 8}) {
    for (const bool competition : {false, true}) {
      const at::Tensor output = Attend(q, k, v, {heads, competition, 0, 0}, std::nullopt);
      EXPECT_TRUE(at::allclose(output, SlowAttention(q, k, v, heads, competition), 1e-4, 1e-5)) << heads;
    }
  }
}

TEST(Attend, DropoutDependsOnKeyLayerAndRowAndKeepsTheMean) {
  SetUpTorchThread();
  const at::Tensor q = at::zeros({100, 256});
  const at::Tensor k = at::zeros({4, 100, 256});
  const at::Tensor v = at::ones({4, 100, 256});
  const auto attend = [&](uint64_t key, int64_t first_row, int64_t layer, int64_t rows) {
    return Attend(q, k.narrow(0, 0, rows), v.narrow(0, 0, rows), {8, false, 0.1, layer}, Dropout{key, first_row});
  };
  const at::Tensor all = attend(7, 0, 0, 4);
  EXPECT_NEAR(all.mean().item<float>(), 1, 0.002);              // 320,000 weights; its deviation is 0.0006
  EXPECT_NEAR(all.var().item<float>(), 0.1 / 0.9 / 100, 1e-4);  // of a mean over 100 weights
  EXPECT_TRUE(all.equal(attend(7, 0, 0, 4)));
  EXPECT_TRUE(all.narrow(0, 2, 2).equal(attend(7, 2, 0, 2)));  // also if the rows are computed separately
  EXPECT_FALSE(all.equal(attend(8, 0, 0, 4)));
  EXPECT_FALSE(all.equal(attend(7, 0, 1, 4)));
  EXPECT_FALSE(all[0].equal(all[1]));
}

TEST(Network, DropoutChangesOnlyUpdatesOfOcSa) {
  SetUpTorchThread();
  Sample sa("oc_sa", "frame_size: 20", 2);
  const at::Tensor plain = sa.net.Forward(sa.input).values;
  EXPECT_FALSE(plain.equal(sa.net.Forward(sa.input, {}, Dropout{5, 0}).values));
  EXPECT_TRUE(
      sa.net.Forward(sa.input, {}, Dropout{5, 0}).values.equal(sa.net.Forward(sa.input, {}, Dropout{5, 0}).values));
  Sample ca("oc_ca", "frame_size: 20", 2);
  EXPECT_TRUE(ca.net.Forward(ca.input).values.equal(ca.net.Forward(ca.input, {}, Dropout{5, 0}).values));
}

// The output of OC-SA for four patches, and for the same with the first two swapped.
std::pair<at::Tensor, at::Tensor> BeforeAndAfterSwap(bool positions) {
  v1::NetworkConfig config;
  config.set_frame_size(4);
  config.set_patch(2);
  config.set_stride(2);
  config.set_heads(8);
  config.set_cls_learned(true);
  config.set_positions(positions);
  ParamList params;
  const SelfAttention part("sa", config, &params);
  at::manual_seed(4);
  ParamTensors tensors;
  for (const ParamSpec& param : params.specs()) tensors.tensors.push_back(at::randn(param.shape) * 0.1);
  const at::Tensor map = at::randn({1, 64, 4, 4});
  const at::Tensor swapped = map.clone();
  swapped.narrow(2, 0, 2).narrow(3, 0, 2).copy_(map.narrow(2, 0, 2).narrow(3, 2, 2));
  swapped.narrow(2, 0, 2).narrow(3, 2, 2).copy_(map.narrow(2, 0, 2).narrow(3, 0, 2));
  return {part.Forward(tensors, map, std::nullopt), part.Forward(tensors, swapped, std::nullopt)};
}

TEST(SelfAttention, DistinguishesPatchOrderOnlyWithPositions) {
  SetUpTorchThread();
  const auto [without, without_swapped] = BeforeAndAfterSwap(false);
  EXPECT_TRUE(at::allclose(without, without_swapped, 1e-4, 1e-4));
  const auto [with, with_swapped] = BeforeAndAfterSwap(true);
  EXPECT_FALSE(at::allclose(with, with_swapped, 1e-2, 1e-2));
}

// Computes steps one by one, like acting, passing the state on.
std::tuple<at::Tensor, at::Tensor, at::Tensor> OneByOne(const PolicyNet& net, const at::Tensor& frames,
                                                        at::Tensor state) {
  std::vector<at::Tensor> logits;
  std::vector<at::Tensor> values;
  for (int64_t step = 0; step < frames.size(0); ++step) {
    const PolicyNet::Output output = net.Forward(frames.narrow(0, step, 1), {{1}, state});
    logits.push_back(output.logits);
    values.push_back(output.values);
    state = output.states;
  }
  return {at::cat(logits), at::cat(values), state};
}

TEST(Network, SegmentsMatchSingleSteps) {
  SetUpTorchThread();
  for (const char* critic : {"critic: LINEAR", "critic: LSTM"}) {
    Sample sample("lstm_cnn", critic, 12);
    ASSERT_EQ(sample.spec.state_size, critic == std::string("critic: LSTM") ? 1024 : 512);
    at::manual_seed(2);
    const std::vector<int> lengths = {2, 5, 1, 4};  // neither sorted nor equal
    const at::Tensor states = at::randn({4, sample.spec.state_size});
    const PolicyNet::Output output = sample.net.Forward(sample.input, {lengths, states});
    int64_t first = 0;
    for (int i = 0; i < 4; ++i) {
      const auto [logits, values, last] =
          OneByOne(sample.net, sample.input.narrow(0, first, lengths[i]), states.narrow(0, i, 1));
      EXPECT_TRUE(at::allclose(output.logits.narrow(0, first, lengths[i]), logits, 1e-4, 1e-5)) << critic << i;
      EXPECT_TRUE(at::allclose(output.values.narrow(0, first, lengths[i]), values, 1e-4, 1e-5)) << critic << i;
      EXPECT_TRUE(at::allclose(output.states.narrow(0, i, 1), last, 1e-4, 1e-5)) << critic << i;
      first += lengths[i];
    }
  }
}

const ParamSpec& ParamNamed(const AgentSpec& spec, const std::string& name) {
  const auto found =
      std::find_if(spec.params.begin(), spec.params.end(), [&](const ParamSpec& p) { return p.name == name; });
  if (found == spec.params.end()) throw std::out_of_range(name);  // fails the test
  return *found;
}

void ExpectRowNorm(const Sample& sample, const std::string& name, double expected) {
  const ParamSpec& param = ParamNamed(sample.spec, name);
  const int64_t columns = param.size / param.shape[0];
  for (int64_t row = 0; row < param.shape[0]; row += 31) {
    const float* begin = &sample.weights[param.offset + row * columns];
    EXPECT_NEAR(std::sqrt(std::inner_product(begin, begin + columns, begin, 0.0)), expected, 1e-5) << name;
  }
}

// Source: AGENTS.md, section 7.
TEST(Resnets, HaveTheirInitialRowNorms) {
  const double sixth = std::sqrt(1 / std::sqrt(6.0));
  const std::map<std::string, std::map<std::string, double>> norms = {
      {"ppo_resnet", {{"stacks.0.first.layer", 1}, {"stacks.1.blocks.1.conv0.layer", sixth}}},
      {"grid_distillation", {{"embed", 1}, {"blocks.1.conv1.layer", std::sqrt(1 / std::sqrt(2.0))}}}};
  for (const auto& [agent, of_agent] : norms) {
    SCOPED_TRACE(agent);
    const Sample sample(agent, "", 2);
    for (const auto& [name, norm] : of_agent) ExpectRowNorm(sample, "features_extractor." + name + ".weight", norm);
    ExpectRowNorm(sample, "features_extractor.linear0.layer.weight", 1.4);
    ExpectRowNorm(sample, "features_extractor.linear1.layer.weight", 1);
    ExpectRowNorm(sample, "action_net.weight", 0.01);
    ExpectRowNorm(sample, "value_net.weight", 0.1);
    const PolicyNet::Output output = sample.net.Forward(sample.input, {{1, 1}, at::zeros({2, sample.spec.state_size})});
    EXPECT_LT(output.logits.abs().max().item<float>(), 0.5);
    EXPECT_NE(output.values[0].item<float>(), output.values[1].item<float>());
  }
}

// The features by their definition, in double, cell by cell where that is simple. Source: AGENTS.md, section 7.
at::Tensor SlowGridFeatures(const Sample& sample, int64_t border) {
  const auto param = [&](const std::string& name) {
    const ParamSpec spec = ParamNamed(sample.spec, "features_extractor." + name);
    return at::tensor(at::ArrayRef<float>(&sample.weights[spec.offset], spec.size)).view(spec.shape).to(at::kDouble);
  };
  const auto norm = [&](const std::string& name, const at::Tensor& x) {  // of each row, over all that it has
    const at::Tensor rows = x.flatten(1);
    const at::Tensor centred = rows - rows.mean(1, true);
    const at::Tensor normal = (centred / (centred.pow(2).mean(1, true) + 1e-5).sqrt()).view_as(x);
    const std::vector<int64_t> shape = x.dim() == 4 ? std::vector<int64_t>{1, -1, 1, 1} : std::vector<int64_t>{1, -1};
    return normal * param(name + ".weight").view(shape) + param(name + ".bias").view(shape);
  };
  const at::Tensor embed = param("embed.weight");
  const int64_t cell = embed.size(2);
  at::Tensor map = at::empty({sample.input.size(0), embed.size(0), 9, 9}, at::kDouble);
  for (int64_t y = 0; y < 9; ++y) {
    for (int64_t x = 0; x < 9; ++x) {
      const at::Tensor pixels = sample.input.narrow(1, border + y * cell, cell).narrow(2, border + x * cell, cell);
      const at::Tensor flat = pixels.permute({0, 3, 1, 2}).flatten(1).to(at::kDouble);
      map.select(3, x).select(2, y).copy_((flat.mm(embed.flatten(1).t()) + param("embed.bias")).relu());
    }
  }
  map = norm("norm", map);
  for (const std::string block : {"blocks.0.", "blocks.1."}) {
    at::Tensor hidden = map;
    for (const std::string conv : {"conv0", "conv1"}) {
      const at::Tensor weight = param(block + conv + ".layer.weight");
      hidden = at::conv2d(norm(block + conv + ".norm", hidden), weight, {}, 1, 1).relu();
    }
    map = map + hidden;
  }
  at::Tensor features = map.flatten(1);
  for (const std::string linear : {"linear0", "linear1"}) {
    features = norm(linear + ".norm", features).mm(param(linear + ".layer.weight").t()).relu();
  }
  return features;
}

TEST(GridResnet, MatchesTheDefinition) {
  SetUpTorchThread();
  // Cells of 7 pixels and one pixel left over on the right and below; cells of 10 between borders of 3.
  for (const auto& [size, border] : {std::pair<int, int>{64, 0}, {96, 3}}) {
    const Sample sample("grid_distillation", absl::StrCat("width: 8 frame_size: ", size), 3);
    const at::Tensor features = sample.net.Codes(sample.input);
    ASSERT_EQ(features.sizes(), (std::vector<int64_t>{3, 512}));
    EXPECT_TRUE(at::allclose(features.to(at::kDouble), SlowGridFeatures(sample, border), 1e-4, 1e-5)) << size;
    EXPECT_FALSE(at::allclose(features[0], features[1], 1e-2, 1e-2)) << size;
  }
}

}  // namespace
}  // namespace craftfleet
