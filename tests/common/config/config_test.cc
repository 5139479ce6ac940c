#include "common/config/config.h"

#include <limits>
#include <string>

#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
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
  EXPECT_TRUE(MessageDifferencer::Equals(
      FromText("precision: FP32 device: CPU overlap: 0 max_staleness: 0 acting_stream: false"), Resolved()));
  EXPECT_EQ(FromText("precision: BF16 device: CUDA_UPDATES").precision(), v1::RunConfig::BF16);
  EXPECT_EQ(FromText("precision: BF16 device: CUDA_UPDATES").device(), v1::RunConfig::CUDA_UPDATES);
}

TEST(RunConfig, Bf16GoesWithCpusThatHaveItAndWithGpus) {
  EXPECT_EQ(FromText("precision: BF16 cpu: AVX512").cpu(), v1::RunConfig::AVX512);
  EXPECT_EQ(FromText("precision: BF16 cpu: AVX2 device: CUDA").cpu(), v1::RunConfig::AVX2);
}

TEST(RunConfig, AnAgentHasItsOwnDefaults) {
  const v1::RunConfig resnet = FromText("agent: \"ppo_resnet\" ppo { epochs: 5 }");
  EXPECT_EQ(resnet.lanes(), 8);
  EXPECT_EQ(resnet.fragment_steps(), 256);
  EXPECT_EQ(resnet.ppo().epochs(), 5) << "the file's";
  EXPECT_EQ(resnet.ppo().minibatch_size(), 512);
  EXPECT_EQ(resnet.ppo().learning_rate(), DefaultRunConfig().ppo().learning_rate());
  EXPECT_EQ(FromText("agent: \"lstm_cnn\"").fragment_steps(), 32);
  EXPECT_EQ(FromText("agent: \"lstm_cnn\" fragment_steps: 64").fragment_steps(), 64);
  const v1::RunConfig published = FromText("agent: \"lstm_cnn_published\"");
  EXPECT_EQ(published.ppo().recurrent_batches(), v1::PpoConfig::PUBLISHED);
  EXPECT_TRUE(published.ppo().truncation_is_terminal());
  EXPECT_EQ(published.ppo().learning_rate(), 1e-4);
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
  // Protobuf counts a tab as up to eight columns.
  EXPECT_THAT(ParseRunConfig("\tppo { epochs: x clip: 1 }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, StartsWith("a.txt:1:16: epochs: ")));
  EXPECT_THAT(ParseRunConfig("\tenv { length: x name: \"crafter\" }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, StartsWith("a.txt:1:16: length: ")));
  EXPECT_THAT(ParseRunConfig("\tsteps: abc", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, StartsWith("a.txt:1:9: steps: ")));
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
  const char* fields;  // set on top of the defaults
  const char* want;    // in the message
};

class RunConfigRange : public testing::TestWithParam<BadValue> {};

TEST_P(RunConfigRange, AnInvalidValuesErrorNamesTheField) {
  v1::RunConfig config = Resolved();
  ASSERT_THAT(ValidateRunConfig(config), IsOk());
  ASSERT_TRUE(google::protobuf::TextFormat::Parser().MergeFromString(GetParam().fields, &config));
  EXPECT_THAT(ValidateRunConfig(config), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(GetParam().want)));
}

INSTANTIATE_TEST_SUITE_P(
    EachField, RunConfigRange,
    testing::Values(
        BadValue{"agent: ''", "agent is empty"}, BadValue{"env { name: '' }", "env.name is empty"},
        BadValue{"env { frame_size: 17 }", "env.frame_size is 17, want 18..1024"},
        BadValue{"env { length: -1 }", "env.length is -1, want 0.."},
        BadValue{"env { length: 1000000001 }", "env.length is 1000000001, want 0..1000000000"},
        BadValue{"steps: 0", "steps is 0, want 1.."}, BadValue{"lanes: 0", "lanes is 0, want 1..4096"},
        BadValue{"fragment_steps: 20000", "fragment_steps is 20000, want 1..16384"},
        BadValue{"tile: 0", "tile is 0, want 1..256"}, BadValue{"overlap: 2", "overlap is 2, want 0..1"},
        BadValue{"max_staleness: -1", "max_staleness is -1, want 0..64"},
        BadValue{"max_staleness: 65", "max_staleness is 65, want 0..64"},
        BadValue{"overlap: 1 max_staleness: 2", "overlap and max_staleness are both given"},
        BadValue{"distillation { every_iterations: 4 } max_staleness: 1",
                 "distillation.every_iterations and max_staleness are both given"},
        BadValue{"precision: PRECISION_UNSPECIFIED",
                 "precision is PRECISION_UNSPECIFIED or unknown, want FP32, TF32 or BF16"},
        BadValue{"device: DEVICE_UNSPECIFIED",
                 "device is DEVICE_UNSPECIFIED or unknown, want CPU, CUDA or CUDA_UPDATES"},
        BadValue{"gradient_shards: 0", "gradient_shards is 0, want 1..256"},
        BadValue{"cpu: CPU_UNSPECIFIED", "cpu is CPU_UNSPECIFIED or unknown, want NATIVE, AVX2 or AVX512"},
        BadValue{"cpu: 77", "cpu is CPU_UNSPECIFIED or unknown"},
        BadValue{"ppo { rollout_steps: 0 }", "ppo.rollout_steps is 0"},
        BadValue{"ppo { minibatch_size: 0 }", "ppo.minibatch_size is 0"},
        BadValue{"ppo { epochs: 0 }", "ppo.epochs is 0, want 1..1000"},
        BadValue{"ppo { learning_rate: -1 }", "ppo.learning_rate is -1, want 0..1"},
        BadValue{"ppo { learning_rate: nan }", "ppo.learning_rate is nan"},
        BadValue{"ppo { gamma: 1.5 }", "ppo.gamma is 1.5, want 0..1"},
        BadValue{"ppo { gamma: 1.0000001 }", "ppo.gamma is 1.0000001, want 0..1"},
        BadValue{"ppo { gae_lambda: 2 }", "ppo.gae_lambda is 2, want 0..1"},
        BadValue{"ppo { clip: 0 }", "ppo.clip is 0, want more than 0"},
        BadValue{"ppo { clip: nan }", "ppo.clip is nan"},
        BadValue{"ppo { value_coefficient: -1 }", "ppo.value_coefficient is -1"},
        BadValue{"ppo { entropy_coefficient: -1 }", "ppo.entropy_coefficient is -1"},
        BadValue{"ppo { max_gradient_norm: 0 }", "ppo.max_gradient_norm is 0"},
        BadValue{"ppo { adam_epsilon: 0 }", "ppo.adam_epsilon is 0"},
        BadValue{"ppo { value_norm_decay: 1 }", "ppo.value_norm_decay is 1, want at least 0, less than 1"},
        BadValue{"ppo { value_norm_start: 0 }", "ppo.value_norm_start is 0, want more than 0"},
        BadValue{"distillation { every_iterations: -1 }", "distillation.every_iterations is -1"},
        BadValue{"distillation { epochs: -1 }", "distillation.epochs is -1"},
        BadValue{"distillation { minibatch_size: 0 }", "distillation.minibatch_size is 0"},
        BadValue{"distillation { targets: -1 }", "distillation.targets is -1"},
        BadValue{"distillation { temperature: 0 }", "distillation.temperature is 0"},
        BadValue{"distillation { transport_regularization: nan }", "distillation.transport_regularization is nan"},
        BadValue{"distillation { transport_rounds: 0 }", "distillation.transport_rounds is 0"},
        BadValue{"distillation { match_threshold: 2 }", "distillation.match_threshold is 2"},
        BadValue{"distillation { every_iterations: 8 }",
                 "distillation.every_iterations is given, but the network has no goal_predictor"},
        BadValue{"eval { every_steps: -1 }", "eval.every_steps is -1, want 0.."},
        BadValue{"eval { episodes: -1 }", "eval.episodes is -1, want 0..10000"},
        BadValue{"eval { final_episodes: 20000 }", "eval.final_episodes is 20000, want"},
        BadValue{"eval { seed: -1 }", "eval.seed is -1, want 0..2147483647"},
        BadValue{"network { frame_size: 30 }", "network.frame_size is 30, want 36..256"},
        BadValue{"checkpoint { every_iterations: 0 }", "checkpoint.every_iterations is 0"},
        BadValue{"checkpoint { keep: 0 }", "checkpoint.keep is 0, want 1..1000"},
        // Relations between values.
        BadValue{"lanes: 3", "ppo.rollout_steps is 4096, want a multiple of lanes (3)"},
        BadValue{"fragment_steps: 100", "ppo.rollout_steps is 4096, want a multiple of lanes * fragment_steps (1600)"},
        BadValue{"ppo { minibatch_size: 100 }",
                 "ppo.rollout_steps is 4096, want a multiple of ppo.minibatch_size (100)"},
        BadValue{"gradient_shards: 3", "ppo.minibatch_size is 128, want a multiple of gradient_shards (3)"},
        BadValue{"precision: BF16 cpu: AVX2",
                 "precision is BF16 and cpu is AVX2, which has no bfloat16: want cpu: NATIVE or AVX512, or precision: "
                 "FP32"},
        BadValue{"precision: BF16 cpu: AVX2 device: CUDA_UPDATES", "precision is BF16 and cpu is AVX2"},
        BadValue{"agent: 'lstm_cnn' ppo { recurrent_batches: RECURRENT_BATCHES_UNSPECIFIED }",
                 "ppo.recurrent_batches is RECURRENT_BATCHES_UNSPECIFIED or unknown, want SEGMENTS or PUBLISHED"}));

}  // namespace
}  // namespace craftfleet
