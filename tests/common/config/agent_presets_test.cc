#include "common/config/agent_presets.h"

#include <string>

#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using Network = v1::NetworkConfig;

// The network of `agent` with the changes that `text` makes.
absl::StatusOr<Network> NetworkOf(const std::string& agent, const std::string& text) {
  v1::RunConfig config;
  config.set_agent(agent);
  EXPECT_TRUE(google::protobuf::TextFormat::ParseFromString(text, config.mutable_network())) << text;
  return ResolveNetwork(config);
}

TEST(AgentPresets, GivenFieldsOverrideTheAgents) {
  const Network network = *NetworkOf("oc_ca", "slots: 16 patch: 8 stride: 8 layer_norm: true");
  EXPECT_EQ(network.slots(), 16);
  EXPECT_EQ(network.patch(), 8);
  EXPECT_TRUE(network.layer_norm());
  EXPECT_EQ(network.heads(), 8);
  EXPECT_EQ(network.extractor(), Network::SPCNN);
}

TEST(AgentPresets, AResidualNetworkHasItsWidthUnlessGiven) {
  EXPECT_EQ(NetworkOf("ppo_resnet", "")->width(), 64);
  EXPECT_EQ(NetworkOf("ppo_cnn", "extractor: RESNET")->width(), 64);
  EXPECT_EQ(NetworkOf("ppo_resnet", "width: 16")->width(), 16);
  EXPECT_EQ(NetworkOf("grid_distillation", "")->width(), 32);
  EXPECT_EQ(NetworkOf("grid_distillation", "width: 48")->width(), 48);
  EXPECT_FALSE(NetworkOf("ppo_cnn", "")->has_width());
}

struct BadNetwork {
  const char* agent;
  const char* text;
  const char* want;  // in the message
};

class AgentPresetsRefuse : public testing::TestWithParam<BadNetwork> {};

TEST_P(AgentPresetsRefuse, InvalidNetworkWithTheFieldsName) {
  const BadNetwork& bad = GetParam();
  EXPECT_THAT(NetworkOf(bad.agent, bad.text), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(bad.want)));
}

INSTANTIATE_TEST_SUITE_P(
    EachField, AgentPresetsRefuse,
    testing::Values(
        BadNetwork{"ppo_gnn", "", "agent \"ppo_gnn\" is unknown; known agents: ppo_cnn, lstm_cnn"},
        BadNetwork{"ppo_cnn", "frame_size: 35", "network.frame_size is 35, want 36..256"},
        BadNetwork{"ppo_spcnn", "frame_size: 300", "network.frame_size is 300, want 9..256"},
        BadNetwork{"ppo_cnn", "extractor: EXTRACTOR_UNSPECIFIED",
                   "network.extractor is EXTRACTOR_UNSPECIFIED or unknown"},
        BadNetwork{"ppo_cnn", "extractor: 7", "or unknown, want CNN, SPCNN, RESNET or GRID_RESNET"},
        BadNetwork{"oc_sa", "objects: OBJECT_MODULE_UNSPECIFIED",
                   "network.objects is OBJECT_MODULE_UNSPECIFIED or unknown"},
        BadNetwork{"oc_sa", "objects: 7", "or unknown, want NO_OBJECTS, SELF_ATTENTION or CROSS_ATTENTION"},
        BadNetwork{"oc_sa", "extractor: CNN", "network.extractor is CNN, want SPCNN"},
        BadNetwork{"oc_sa", "patch: 73", "network.patch is 73, want 1..72"},
        BadNetwork{"oc_ca", "frame_size: 15", "network.patch is 16, want 1..15"},
        BadNetwork{"oc_ca", "stride: 0", "network.stride is 0, want 1..72"},
        BadNetwork{"oc_ca", "heads: 0", "network.heads is 0, want 1..256"},
        BadNetwork{"oc_ca", "heads: 3", "network.heads is 3, want a divisor of 256"},
        BadNetwork{"oc_ca", "slots: 0", "network.slots is 0, want 1..256"},
        BadNetwork{"oc_sa", "dropout: 1", "network.dropout is 1, want at least 0, less than 1"},
        BadNetwork{"oc_sa", "dropout: nan", "network.dropout is nan"},
        BadNetwork{"oc_sa", "slots: 4", "network.slots is given, but only objects: CROSS_ATTENTION has it"},
        BadNetwork{"oc_ca", "positions: true", "network.positions is given, but only objects: SELF_ATTENTION has it"},
        BadNetwork{"ppo_cnn", "heads: 4", "network.heads is given, but only a network with objects has it"},
        BadNetwork{"ppo_cnn", "critic: LSTM", "network.critic is given, but only recurrent: true has it"},
        BadNetwork{"ppo_resnet", "width: 0", "network.width is 0, want 1..256"},
        BadNetwork{"grid_distillation", "width: 257", "network.width is 257, want 1..256"},
        BadNetwork{"grid_distillation", "frame_size: 8", "network.frame_size is 8, want 9..256"},
        BadNetwork{"ppo_cnn", "width: 16", "network.width is given, but only extractor: RESNET or GRID_RESNET has it"},
        BadNetwork{"lstm_cnn", "memory: true", "network.memory is true, want NO_OBJECTS and recurrent: false"},
        BadNetwork{"oc_sa", "goal_predictor: true", "network.goal_predictor is true, want NO_OBJECTS and"},
        BadNetwork{"lstm_cnn", "critic: 9", "network.critic is CRITIC_UNSPECIFIED or unknown, want LINEAR or LSTM"},
        BadNetwork{"ppo_cnn", "recurrent: true", "network.critic is CRITIC_UNSPECIFIED or unknown"}));

}  // namespace
}  // namespace craftfleet
