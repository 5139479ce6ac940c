// The attention maps of networks with an object module.

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "common/agent/initial_weights.h"
#include "common/agent/policy.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/config/agent_presets.h"
#include "tests/agent/golden_agent.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::Each;
using testing::FloatNear;
using testing::HasSubstr;

// InitialWeights, made once for each agent and network.
const std::vector<float>& WeightsOf(const AgentSpec& spec, const std::string& agent, const std::string& network) {
  static auto* const known = new std::map<std::string, std::vector<float>>;
  std::vector<float>& weights = (*known)[absl::StrCat(agent, " ", network)];
  if (weights.empty()) weights = InitialWeights(spec, 1);
  return weights;
}

// An agent with initial weights, which a test may change, and frames for it.
struct SampleAgent {
  explicit SampleAgent(const std::string& agent, const std::string& network = "") {
    v1::RunConfig config;
    config.set_agent(agent);
    EXPECT_TRUE(google::protobuf::TextFormat::ParseFromString(network, config.mutable_network()));
    spec = *MakeAgentSpec(config);
    weights = WeightsOf(spec, agent, network);
  }

  absl::Span<float> Param(const std::string& name) {
    const auto param = std::find_if(spec.params.begin(), spec.params.end(),
                                    [&](const ParamSpec& p) { return p.name == "features_extractor.rsn." + name; });
    EXPECT_TRUE(param != spec.params.end()) << name;
    return absl::MakeSpan(weights).subspan(param->offset, param->size);
  }
  AttentionMap Look(uint32_t frame_seed = 3) const {
    const auto policy = *Policy::Create(spec, SaveWeights(spec, weights), 8);
    const auto map = policy->Attention(GoldenFrames(frame_seed, 1, spec.frame_size));
    EXPECT_THAT(map, IsOk());
    return *map;
  }

  AgentSpec spec;
  std::vector<float> weights;
};

double Sum(const AttentionMap& map, int view) {
  const auto begin = map.weights.begin() + view * map.patches.count();
  return std::accumulate(begin, begin + map.patches.count(), 0.0);
}

// Every agent by name: maps of the shape given by its network, or an error.
TEST(Attention, IsADistributionOverPatchesForAgentsThatHaveIt) {
  for (const absl::string_view agent : AgentNames()) {
    const std::string name(agent);
    SCOPED_TRACE(name);
    v1::RunConfig config;
    config.set_agent(name);
    const v1::NetworkConfig network = *ResolveNetwork(config);
    if (network.objects() == v1::NetworkConfig::NO_OBJECTS) {
      if (network.extractor() == v1::NetworkConfig::SPCNN) continue;  // 540 MB of weights, and the same error
      const AgentSpec spec = *MakeAgentSpec(config);
      const auto policy = *Policy::Create(spec, SaveWeights(spec, std::vector<float>(spec.param_count)), 1);
      EXPECT_THAT(policy->Attention(GoldenFrames(3, 1, spec.frame_size)),
                  StatusIs(absl::StatusCode::kInvalidArgument,
                           "agent " + name + " has no attention to show; only oc_sa and oc_ca do"));
      continue;
    }
    const AttentionMap map = SampleAgent(name).Look();
    const bool self = network.objects() == v1::NetworkConfig::SELF_ATTENTION;
    EXPECT_EQ(map.views, 8);
    EXPECT_EQ(map.patches.frame_size, 72);
    EXPECT_EQ(map.patches.count(), self ? 64 : 16);
    ASSERT_EQ(map.weights.size(), static_cast<size_t>(map.views * map.patches.count()));
    for (const float weight : map.weights) ASSERT_GE(weight, 0);
    for (int view = 0; view < map.views; ++view) {
      // OC-SA's CLS token attends to itself too.
      if (self) {
        EXPECT_LT(Sum(map, view), 1);
        EXPECT_GT(Sum(map, view), 0.1);
      } else {
        EXPECT_NEAR(Sum(map, view), 1, 1e-5);
      }
    }
  }
}

TEST(Attention, OfAblationsHasTheConfiguredSlotsAndPatches) {
  const AttentionMap map = SampleAgent("oc_ca",
                                       "patch: 12 stride: 8 slots: 3 heads: 2 slot_competition: true "
                                       "layer_norm: true")
                               .Look();
  EXPECT_EQ(map.views, 3);
  EXPECT_EQ(map.patches.count(), 64);
  for (int view = 0; view < 3; ++view) EXPECT_NEAR(Sum(map, view), 1, 1e-5);
}

TEST(Attention, DependsOnTheFrame) {
  const SampleAgent sample("oc_sa");
  EXPECT_EQ(sample.Look(3).weights, sample.Look(3).weights);
  EXPECT_NE(sample.Look(3).weights, sample.Look(4).weights);
}

TEST(Attention, OfZeroQueriesIsUniform) {
  SampleAgent oc_ca("oc_ca");
  for (float& weight : oc_ca.Param("layer.to_q.weight")) weight = 0;
  EXPECT_THAT(oc_ca.Look().weights, Each(FloatNear(1.0F / 16, 1e-6)));
  SampleAgent oc_sa("oc_sa");
  const absl::Span<float> qkv = oc_sa.Param("trafo.layers.1.qkv_net.weight");  // queries first, [3*256,256]
  std::fill_n(qkv.begin(), qkv.size() / 3, 0.0F);
  EXPECT_THAT(oc_sa.Look().weights, Each(FloatNear(1.0F / 65, 1e-6)));
}

// With values that encode only the patch's position p in -1..1, the features of one head are the mean of p under each
// slot's map. So the test checks that the forward pass uses these maps, with the patches in the right order.
TEST(Attention, MatchesTheForwardPass) {
  SetUpTorchThread();
  SampleAgent sample("oc_ca", "heads: 1");
  const absl::Span<float> keys_values = sample.Param("layer.to_kv.weight");  // [2*256,width], p last
  const size_t width = keys_values.size() / 512;
  std::fill(keys_values.begin() + static_cast<int64_t>(keys_values.size() / 2), keys_values.end(), 0.0F);
  keys_values[keys_values.size() / 2 + width - 1] = 1;
  for (float& weight : sample.Param("layer.to_q.weight")) weight *= 20;  // far from uniform
  const AttentionMap map = sample.Look();
  double wanted = 0;
  for (size_t i = 0; i < map.weights.size(); ++i) {
    wanted += map.weights[i] * (-1 + 2.0 * static_cast<double>(i % 16) / 15) / 8;
  }
  ParamList params;
  const Network network(sample.spec.network, &params);
  ParamTensors tensors;
  for (const ParamSpec& param : sample.spec.params) {
    tensors.tensors.push_back(at::from_blob(sample.weights.data() + param.offset, param.shape));
  }
  const at::Tensor input = AsInput(GoldenFrames(3, 1, 72), sample.spec);
  const at::Tensor features = network.Features(tensors, input, std::nullopt);
  EXPECT_NEAR(features[0][0].item<float>(), wanted, 1e-5);
  EXPECT_GT(std::abs(wanted), 1e-3);
}

// One head of OC-SA: each patch's share is exp(q k / 16), of the CLS token's row.
TEST(Attention, OfSelfAttentionIsTheClsRowOfTheLastLayer) {
  SampleAgent sample("oc_sa", "heads: 1");
  const AttentionMap before = sample.Look();
  // Doubled queries square each share.
  const absl::Span<float> qkv = sample.Param("trafo.layers.1.qkv_net.weight");
  for (size_t i = 0; i < qkv.size() / 3; ++i) qkv[i] *= 2;
  const AttentionMap after = sample.Look();
  for (size_t i = 1; i < before.weights.size(); ++i) {
    const double ratio = before.weights[i] / before.weights[0];
    EXPECT_NEAR(after.weights[i] / after.weights[0], ratio * ratio, 1e-3 * ratio * ratio);
  }
}

TEST(Attention, RequiresOneFrame) {
  const SampleAgent sample("oc_ca", "frame_size: 24 patch: 12 stride: 12");
  const auto policy = *Policy::Create(sample.spec, SaveWeights(sample.spec, sample.weights), 8);
  EXPECT_THAT(policy->Attention(GoldenFrames(3, 2, 24)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("3456 bytes of a frame, want 1728")));
}

}  // namespace
}  // namespace craftfleet
