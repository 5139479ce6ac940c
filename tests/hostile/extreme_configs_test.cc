// Configurations at the limits of their fields: the learner either refuses them at once and names the field, or starts
// within a memory bound.

#include <sys/resource.h>

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/sanitizers.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

struct Extreme {
  std::string config;
  std::string error;  // empty: the learner starts
};

class ExtremeConfigsTest : public SmallRunTest, public testing::WithParamInterface<Extreme> {};

TEST_P(ExtremeConfigsTest, AreRefusedOrStart) {
  ASSERT_THAT(WriteFileSynced(config(), GetParam().config), IsOk());
  const auto learner = Start("craftfleet-learner", Flags("run", {"--listen=127.0.0.1:0"}));
  if (!kAddressSanitizer) {
    const rlimit memory = {rlim_t{24} << 30, RLIM_INFINITY};  // of address space: a waiting learner takes some GiB
    ASSERT_EQ(prlimit(learner->pid(), RLIMIT_AS, &memory, nullptr), 0);
  }
  if (GetParam().error.empty()) {
    EXPECT_THAT(learner->WaitForAddress("listening on ", kPatience), IsOk());
    return;
  }
  const Ended ended = Finish(learner.get());
  EXPECT_EQ(ended.exit_code, 1) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr(GetParam().error));
  EXPECT_THAT(ended.err, HasSubstr("want "));
  EXPECT_FALSE(PathExists(Logdir("run"))) << "refused before anything is made";
}

INSTANTIATE_TEST_SUITE_P(
    Fields, ExtremeConfigsTest,
    testing::Values(
        Extreme{"fragment_steps: 8192 ppo { rollout_steps: 131072 minibatch_size: 128 }", "fragment_steps is 8192: "},
        Extreme{"fragment_steps: 4096 ppo { rollout_steps: 65536 minibatch_size: 128 }", ""},
        Extreme{"agent: \"lstm_cnn_published\" fragment_steps: 8192 lanes: 1 ppo { rollout_steps: 8192 }",
                "fragment_steps is 8192: "},
        // Terabytes: more than any test machine has.
        Extreme{"network { frame_size: 256 } ppo { rollout_steps: 16777216 }",
                "ppo.rollout_steps is 16777216: the learner needs at least"},
        Extreme{"network { frame_size: 256 } ppo { rollout_steps: 1048576 minibatch_size: 1048576 }",
                "ppo.minibatch_size is 1048576: "},
        Extreme{"agent: \"ppo_spcnn\" network { frame_size: 256 } gradient_shards: 256 ppo { minibatch_size: 256 }",
                "gradient_shards is 256: "},
        Extreme{"agent: \"oc_sa\" network { frame_size: 256 patch: 1 stride: 1 }", "network.stride is 1: "},
        Extreme{"gradient_shards: 256 ppo { minibatch_size: 256 }", ""},
        Extreme{"lanes: 4096 ppo { rollout_steps: 4096 }", ""},
        Extreme{"ppo { learning_rate: nan }", "ppo.learning_rate is nan"},
        Extreme{"agent: \"ppo_spcnn\" network { frame_size: 17 }", "network.frame_size is 17"},
        Extreme{"agent: \"ppo_spcnn\" network { frame_size: 18 }", ""},
        Extreme{"ppo { adam_epsilon: 5e-324 }", "ppo.adam_epsilon is "},
        Extreme{
            "steps: 1000000000000 tile: 256 ppo { epochs: 1000 } checkpoint { every_iterations: 1000000 keep: 1000 }",
            ""}),
    [](const auto& info) { return absl::StrCat("N", info.index); });

class ExtremeRunsTest : public SmallRunTest {};

// The learner used to refuse what actors made of such weights, for ever.
TEST_F(ExtremeRunsTest, TrainingThatDivergesEndsWithItsReasonAndACheckpointThatResumes) {
  ASSERT_THAT(WriteFileSynced(config(), R"(
    steps: 192  lanes: 4  fragment_steps: 16
    ppo { rollout_steps: 64  minibatch_size: 32  epochs: 1  learning_rate: 1 }
    eval { every_steps: 0  final_episodes: 0 }
  )"),
              IsOk());
  for (const std::vector<std::string>& more : {std::vector<std::string>{}, {"--resume"}}) {
    const Ended ended = Run("craftfleet train", Flags("run", more));
    EXPECT_EQ(ended.exit_code, 1) << ended.err;
    EXPECT_THAT(ended.err, HasSubstr("training diverges"));
    EXPECT_THAT(ended.err, HasSubstr("a smaller ppo.learning_rate"));
  }
  EXPECT_TRUE(PathExists(Checkpoint("run", 0)));
}

}  // namespace
}  // namespace craftfleet
