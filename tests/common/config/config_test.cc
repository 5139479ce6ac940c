#include "common/config/config.h"

#include <cstring>
#include <functional>
#include <limits>
#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <google/protobuf/util/message_differencer.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using google::protobuf::util::MessageDifferencer;
using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

v1::RunConfig Resolved() { return ResolveRunConfig(DefaultRunConfig()).value(); }

v1::RunConfig FromText(const std::string& text) { return ResolveRunConfig(ParseRunConfig(text, "f").value()).value(); }

TEST(RunConfig, AnEmptyFileGivesTheDefaults) { EXPECT_TRUE(MessageDifferencer::Equals(FromText(""), Resolved())); }

TEST(RunConfig, PrecisionDeviceOverlapAndStalenessAreAbsentUnlessChosen) {
  EXPECT_FALSE(Resolved().has_precision());
  EXPECT_FALSE(Resolved().has_device());
  EXPECT_FALSE(Resolved().has_overlap());
  EXPECT_FALSE(Resolved().has_max_staleness());
  EXPECT_TRUE(
      MessageDifferencer::Equals(FromText("precision: FP32 device: CPU overlap: 0 max_staleness: 0"), Resolved()));
  EXPECT_EQ(FromText("precision: BF16 device: CUDA_UPDATES").precision(), v1::RunConfig::BF16);
  EXPECT_EQ(FromText("precision: BF16 device: CUDA_UPDATES").device(), v1::RunConfig::CUDA_UPDATES);
}

TEST(RunConfig, AnAgentHasItsOwnDefaults) {
  const v1::RunConfig resnet = FromText("agent: \"ppo_resnet\" ppo { epochs: 5 }");
  EXPECT_EQ(resnet.lanes(), 8);
  EXPECT_EQ(resnet.fragment_steps(), 256);
  EXPECT_EQ(resnet.ppo().epochs(), 5);  // the file's
  EXPECT_EQ(resnet.ppo().minibatch_size(), 512);
  EXPECT_EQ(resnet.ppo().entropy_coefficient(), 0.01);
  EXPECT_EQ(resnet.ppo().value_norm_decay(), 0.99);
  EXPECT_EQ(resnet.ppo().learning_rate(), 3e-4);
  EXPECT_EQ(FromText("agent: \"lstm_cnn\"").fragment_steps(), 32);
  EXPECT_EQ(FromText("agent: \"lstm_cnn\" fragment_steps: 64").fragment_steps(), 64);
  const v1::RunConfig published = FromText("agent: \"lstm_cnn_published\"");
  EXPECT_EQ(published.ppo().recurrent_batches(), v1::PpoConfig::PUBLISHED);
  EXPECT_TRUE(published.ppo().truncation_is_terminal());
  EXPECT_EQ(published.ppo().learning_rate(), 1e-4);
}

// Moon et al. 2023, as its code does it.
TEST(RunConfig, ThePublishedResidualAgentsHaveTheirOwnDefaults) {
  for (const char* agent :
       {"ppo_resnet_published", "achievement_distillation", "cnn_distillation", "grid_distillation"}) {
    const v1::RunConfig config = FromText(std::string("agent: \"") + agent + "\"");
    EXPECT_EQ(config.lanes(), 8);
    EXPECT_EQ(config.fragment_steps(), 512);
    EXPECT_EQ(config.ppo().epochs(), 3);
    EXPECT_EQ(config.ppo().minibatch_size(), 512);
    EXPECT_EQ(config.ppo().entropy_coefficient(), 0.01);
    EXPECT_EQ(config.ppo().adam_epsilon(), 1e-8);
    EXPECT_TRUE(config.ppo().truncation_is_terminal());
    EXPECT_TRUE(config.ppo().advantages_over_rollout());
    EXPECT_EQ(config.ppo().value_norm_decay(), 0.99);
    EXPECT_EQ(config.ppo().value_norm_start(), 0.1);
  }
  const v1::RunConfig distillation = FromText("agent: \"achievement_distillation\"");
  EXPECT_EQ(distillation.distillation().every_iterations(), 8);
  EXPECT_EQ(distillation.distillation().epochs(), 6);
  EXPECT_EQ(distillation.distillation().minibatch_size(), 512);
  EXPECT_EQ(distillation.distillation().targets(), 16);
  EXPECT_EQ(distillation.distillation().temperature(), 0.1);
  EXPECT_EQ(distillation.distillation().transport_regularization(), 0.05);
  EXPECT_EQ(distillation.distillation().transport_rounds(), 100);
  EXPECT_EQ(distillation.distillation().match_threshold(), 0.5);
  EXPECT_EQ(FromText("agent: \"ppo_resnet\"").ppo().adam_epsilon(), 1e-5);
}

TEST(RunConfig, AnAgentsFragmentStepsGiveWayToOtherLanes) {
  EXPECT_EQ(FromText("agent: \"ppo_resnet_published\" lanes: 4").fragment_steps(), 512);
  EXPECT_EQ(FromText("agent: \"ppo_resnet_published\" lanes: 16").fragment_steps(), 256);
}

TEST(RunConfig, RecurrentNetworksHaveShortFragmentsWhateverTheAgent) {
  EXPECT_EQ(FromText("agent: \"ppo_cnn\" network { recurrent: true critic: LSTM }").fragment_steps(), 32);
  EXPECT_EQ(FromText("agent: \"lstm_cnn\" network { recurrent: false }").fragment_steps(), 256);
}

TEST(RunConfig, AnUnknownAgentsErrorListsTheKnownOnes) {
  EXPECT_THAT(ResolveRunConfig(ParseRunConfig("agent: \"ppo_rnn\"", "f").value()),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("agent \"ppo_rnn\" is unknown"), HasSubstr("ppo_cnn, lstm_cnn, "))));
}

TEST(RunConfig, ExplicitZerosOverrideDefaults) {
  const v1::RunConfig config = FromText(
      "seed: 7  # lucky\nppo { gae_lambda: 0 truncation_is_terminal: true }\nenv { length: 500 }\neval { every_steps: "
      "0 }");
  EXPECT_EQ(config.eval().every_steps(), 0);
  EXPECT_EQ(config.seed(), 7U);
  EXPECT_EQ(config.ppo().gae_lambda(), 0);
  EXPECT_TRUE(config.ppo().truncation_is_terminal());
  EXPECT_EQ(config.env().length(), 500);
  EXPECT_EQ(config.env().name(), "crafter");
  EXPECT_EQ(config.ppo().gamma(), 0.95);
}

TEST(RunConfig, AnUnknownFieldsErrorHasItsPositionAndTheKnownFields) {
  EXPECT_THAT(
      ParseRunConfig("seed: 1\nppo {\n  learning_rat: 1e-3\n}\n", "runs/a.txt"),
      StatusIs(absl::StatusCode::kInvalidArgument,
               AllOf(StartsWith("runs/a.txt:3:15: "), HasSubstr("\"learning_rat\""),
                     HasSubstr("known fields of PpoConfig: rollout_steps, minibatch_size, epochs, learning_rate, "))));
}

TEST(RunConfig, ARemovedFieldsErrorSaysToLeaveItOut) {
  for (const char* field : {"decoupled_objective: true", "vtrace_rho_bar: 1", "vtrace_c_bar: 1",
                            "recompute_values: true", "correction_pass: true"}) {
    EXPECT_THAT(ParseRunConfig(absl::StrCat("overlap: 1\nppo { ", field, " }"), "a.txt"),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(StartsWith("a.txt:2:"), HasSubstr(std::string(field, std::strcspn(field, ":"))),
                               HasSubstr("removed in version 0.2: leave it out; "))));
  }
}

TEST(RunConfig, AnUnknownValueOfAnEnumerationsErrorListsTheKnownOnes) {
  EXPECT_THAT(ParseRunConfig("precision: FP16", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("\"FP16\""), HasSubstr("known values: FP32, TF32, BF16)"))));
  EXPECT_THAT(ParseRunConfig("network { extractor: VIT }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("known values: CNN, SPCNN, ")));
}

TEST(RunConfig, AMalformedValuesErrorHasItsPositionAndField) {
  EXPECT_THAT(ParseRunConfig("ppo { learning_rate: fast }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(StartsWith("a.txt:1:22: learning_rate: "), HasSubstr("fast"))));
  EXPECT_THAT(ParseRunConfig("\nlanes: -99999999999", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, AllOf(StartsWith("a.txt:2:"), HasSubstr("lanes"))));
  EXPECT_THAT(ParseRunConfig("seed: 1 seed: 2", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, AllOf(StartsWith("a.txt:1:"), HasSubstr("seed"))));
  EXPECT_THAT(ParseRunConfig("ppo {", "a.txt"), StatusIs(absl::StatusCode::kInvalidArgument, StartsWith("a.txt:1:")));
  EXPECT_THAT(ParseRunConfig("\xFF\xFE{]", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, StartsWith("a.txt:")));
}

TEST(RunConfig, FormattedTextParsesToTheSameConfig) {
  v1::RunConfig config = Resolved();
  config.set_seed(std::numeric_limits<uint64_t>::max());
  config.mutable_env()->set_name("crafter:numbers=easy-x2,inventory=off");
  config.mutable_ppo()->set_learning_rate(0.1 + 0.2);
  config.mutable_ppo()->set_gae_lambda(0);
  const std::string text = FormatRunConfig(config);
  EXPECT_TRUE(MessageDifferencer::Equals(ParseRunConfig(text, "f").value(), config)) << text;
}

TEST(RunConfig, FormatIsStable) {
  EXPECT_EQ(FormatRunConfig(Resolved()), R"(agent: "ppo_cnn"
env {
  name: "crafter"
  frame_size: 0
  length: 0
}
steps: 1000000
seed: 0
lanes: 16
fragment_steps: 256
tile: 8
gradient_shards: 2
ppo {
  rollout_steps: 4096
  minibatch_size: 128
  epochs: 4
  learning_rate: 0.0003
  gamma: 0.95
  gae_lambda: 0.65
  clip: 0.2
  value_coefficient: 0.5
  entropy_coefficient: 0
  max_gradient_norm: 0.5
  adam_epsilon: 1e-05
  truncation_is_terminal: false
  recurrent_batches: SEGMENTS
  value_norm_decay: 0
  value_norm_start: 1
  advantages_over_rollout: false
}
checkpoint {
  every_iterations: 10
  keep: 3
}
eval {
  every_steps: 50000
  episodes: 5
  final_episodes: 20
  seed: 0
}
cpu: NATIVE
distillation {
  every_iterations: 0
  epochs: 6
  minibatch_size: 512
  targets: 16
  temperature: 0.1
  transport_regularization: 0.05
  transport_rounds: 100
  match_threshold: 0.5
}
)");
}

TEST(RunConfig, DefaultFragmentStepsDivideTheStepsOfALane) {
  const auto fragment_steps = [](int rollout, int lanes) {
    v1::RunConfig config = DefaultRunConfig();
    config.mutable_ppo()->set_rollout_steps(rollout);
    config.mutable_ppo()->set_minibatch_size(lanes * 2);
    config.set_lanes(lanes);
    return ResolveRunConfig(config).value().fragment_steps();
  };
  EXPECT_EQ(fragment_steps(4096, 16), 256);
  EXPECT_EQ(fragment_steps(4096, 1), 256);
  EXPECT_EQ(fragment_steps(4096, 64), 64);
  EXPECT_EQ(fragment_steps(3000, 10), 150);  // 300 steps a lane: 256 does not divide it
  EXPECT_EQ(fragment_steps(514, 1), 2);      // 514 = 2 * 257
}

TEST(RunConfig, GivenFragmentStepsAreKept) {
  v1::RunConfig config = DefaultRunConfig();
  config.set_fragment_steps(64);
  EXPECT_EQ(ResolveRunConfig(config).value().fragment_steps(), 64);
  config.set_fragment_steps(0);
  EXPECT_THAT(ResolveRunConfig(config),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("fragment_steps is 0, want 1..16384")));
}

struct BadValue {
  const char* want;  // in the message
  std::function<void(v1::RunConfig*)> spoil;
};

class RunConfigRange : public testing::TestWithParam<BadValue> {};

TEST_P(RunConfigRange, AnInvalidValuesErrorNamesTheField) {
  v1::RunConfig config = Resolved();
  ASSERT_THAT(ValidateRunConfig(config), IsOk());
  GetParam().spoil(&config);
  EXPECT_THAT(ValidateRunConfig(config), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(GetParam().want)));
}

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

INSTANTIATE_TEST_SUITE_P(
    EachField, RunConfigRange,
    testing::Values(
        BadValue{"agent is empty", [](auto* c) { c->set_agent(""); }},
        BadValue{"env.name is empty", [](auto* c) { c->mutable_env()->set_name(""); }},
        BadValue{"env.frame_size is 17, want 18..1024", [](auto* c) { c->mutable_env()->set_frame_size(17); }},
        BadValue{"env.length is -1, want 0..", [](auto* c) { c->mutable_env()->set_length(-1); }},
        BadValue{"env.length is 1000000001, want 0..1000000000",
                 [](auto* c) { c->mutable_env()->set_length(1'000'000'001); }},
        BadValue{"steps is 0, want 1..", [](auto* c) { c->set_steps(0); }},
        BadValue{"lanes is 0, want 1..4096", [](auto* c) { c->set_lanes(0); }},
        BadValue{"fragment_steps is 20000, want 1..16384", [](auto* c) { c->set_fragment_steps(20000); }},
        BadValue{"tile is 0, want 1..256", [](auto* c) { c->set_tile(0); }},
        BadValue{"overlap is 2, want 0..1", [](auto* c) { c->set_overlap(2); }},
        BadValue{"max_staleness is -1, want 0..64", [](auto* c) { c->set_max_staleness(-1); }},
        BadValue{"max_staleness is 65, want 0..64", [](auto* c) { c->set_max_staleness(65); }},
        BadValue{"overlap and max_staleness are both given",
                 [](auto* c) {
                   c->set_overlap(1);
                   c->set_max_staleness(2);
                 }},
        BadValue{"checkpoint.keep_fragments and max_staleness are both given",
                 [](auto* c) {
                   c->mutable_checkpoint()->set_keep_fragments(true);
                   c->set_max_staleness(1);
                 }},
        BadValue{"distillation.every_iterations and max_staleness are both given",
                 [](auto* c) {
                   c->mutable_distillation()->set_every_iterations(4);
                   c->set_max_staleness(1);
                 }},
        BadValue{"precision is PRECISION_UNSPECIFIED or unknown, want FP32, TF32 or BF16",
                 [](auto* c) { c->set_precision(v1::RunConfig::PRECISION_UNSPECIFIED); }},
        BadValue{"device is DEVICE_UNSPECIFIED or unknown, want CPU, CUDA or CUDA_UPDATES",
                 [](auto* c) { c->set_device(v1::RunConfig::DEVICE_UNSPECIFIED); }},
        BadValue{"gradient_shards is 0, want 1..256", [](auto* c) { c->set_gradient_shards(0); }},
        BadValue{"cpu is CPU_UNSPECIFIED", [](auto* c) { c->set_cpu(v1::RunConfig::CPU_UNSPECIFIED); }},
        BadValue{"want NATIVE, AVX2 or AVX512", [](auto* c) { c->set_cpu(static_cast<v1::RunConfig::Cpu>(77)); }},
        BadValue{"ppo.rollout_steps is 0", [](auto* c) { c->mutable_ppo()->set_rollout_steps(0); }},
        BadValue{"ppo.minibatch_size is 0", [](auto* c) { c->mutable_ppo()->set_minibatch_size(0); }},
        BadValue{"ppo.epochs is 0, want 1..1000", [](auto* c) { c->mutable_ppo()->set_epochs(0); }},
        BadValue{"ppo.learning_rate is -1, want 0..1", [](auto* c) { c->mutable_ppo()->set_learning_rate(-1); }},
        BadValue{"ppo.learning_rate is nan", [](auto* c) { c->mutable_ppo()->set_learning_rate(kNan); }},
        BadValue{"ppo.gamma is 1.5, want 0..1", [](auto* c) { c->mutable_ppo()->set_gamma(1.5); }},
        BadValue{"ppo.gae_lambda is 2, want 0..1", [](auto* c) { c->mutable_ppo()->set_gae_lambda(2); }},
        BadValue{"ppo.clip is 0, want more than 0", [](auto* c) { c->mutable_ppo()->set_clip(0); }},
        BadValue{"ppo.clip is nan", [](auto* c) { c->mutable_ppo()->set_clip(kNan); }},
        BadValue{"ppo.value_coefficient is -1", [](auto* c) { c->mutable_ppo()->set_value_coefficient(-1); }},
        BadValue{"ppo.entropy_coefficient is -1", [](auto* c) { c->mutable_ppo()->set_entropy_coefficient(-1); }},
        BadValue{"ppo.max_gradient_norm is 0", [](auto* c) { c->mutable_ppo()->set_max_gradient_norm(0); }},
        BadValue{"ppo.adam_epsilon is 0", [](auto* c) { c->mutable_ppo()->set_adam_epsilon(0); }},
        BadValue{"ppo.value_norm_decay is 1, want at least 0, less than 1",
                 [](auto* c) { c->mutable_ppo()->set_value_norm_decay(1); }},
        BadValue{"ppo.value_norm_start is 0, want more than 0",
                 [](auto* c) { c->mutable_ppo()->set_value_norm_start(0); }},
        BadValue{"distillation.every_iterations is -1",
                 [](auto* c) { c->mutable_distillation()->set_every_iterations(-1); }},
        BadValue{"distillation.epochs is -1", [](auto* c) { c->mutable_distillation()->set_epochs(-1); }},
        BadValue{"distillation.minibatch_size is 0", [](auto* c) { c->mutable_distillation()->set_minibatch_size(0); }},
        BadValue{"distillation.targets is -1", [](auto* c) { c->mutable_distillation()->set_targets(-1); }},
        BadValue{"distillation.temperature is 0", [](auto* c) { c->mutable_distillation()->set_temperature(0); }},
        BadValue{"distillation.transport_regularization is nan",
                 [](auto* c) { c->mutable_distillation()->set_transport_regularization(kNan); }},
        BadValue{"distillation.transport_rounds is 0",
                 [](auto* c) { c->mutable_distillation()->set_transport_rounds(0); }},
        BadValue{"distillation.match_threshold is 2",
                 [](auto* c) { c->mutable_distillation()->set_match_threshold(2); }},
        BadValue{"distillation.every_iterations is given, but the network has no goal_predictor",
                 [](auto* c) { c->mutable_distillation()->set_every_iterations(8); }},
        BadValue{"eval.every_steps is -1, want 0..", [](auto* c) { c->mutable_eval()->set_every_steps(-1); }},
        BadValue{"eval.episodes is -1, want 0..10000", [](auto* c) { c->mutable_eval()->set_episodes(-1); }},
        BadValue{"eval.final_episodes is 20000, want", [](auto* c) { c->mutable_eval()->set_final_episodes(20000); }},
        BadValue{"eval.seed is -1, want 0..2147483647", [](auto* c) { c->mutable_eval()->set_seed(-1); }},
        BadValue{"agent \"x\" is unknown", [](auto* c) { c->set_agent("x"); }},
        BadValue{"network.frame_size is 30, want 36..256", [](auto* c) { c->mutable_network()->set_frame_size(30); }},
        BadValue{"checkpoint.every_iterations is 0", [](auto* c) { c->mutable_checkpoint()->set_every_iterations(0); }},
        BadValue{"checkpoint.keep is 0, want 1..1000", [](auto* c) { c->mutable_checkpoint()->set_keep(0); }},
        // Relations between values.
        BadValue{"ppo.rollout_steps is 4096, want a multiple of lanes (3)", [](auto* c) { c->set_lanes(3); }},
        BadValue{"ppo.rollout_steps is 4096, want a multiple of lanes * fragment_steps (1600)",
                 [](auto* c) { c->set_fragment_steps(100); }},
        BadValue{"ppo.rollout_steps is 4096, want a multiple of ppo.minibatch_size (100)",
                 [](auto* c) { c->mutable_ppo()->set_minibatch_size(100); }},
        BadValue{"ppo.minibatch_size is 128, want a multiple of gradient_shards (3)",
                 [](auto* c) { c->set_gradient_shards(3); }},
        BadValue{"ppo.recurrent_batches is RECURRENT_BATCHES_UNSPECIFIED, want SEGMENTS or PUBLISHED", [](auto* c) {
                   c->set_agent("lstm_cnn");
                   c->mutable_ppo()->clear_recurrent_batches();
                 }}));

}  // namespace
}  // namespace craftfleet
