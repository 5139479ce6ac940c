// Configurations at the limits of their fields: the learner either refuses them at once and names the field, or starts
// within a memory bound.

#include <sys/resource.h>

#include <memory>
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

class ExtremeConfigsTest : public SmallRunTest {
 protected:
  std::unique_ptr<Process> StartLearner(const std::string& text) {
    EXPECT_THAT(WriteFileSynced(config(), text), IsOk());
    auto learner = Start("craftfleet-learner", Flags("run", {"--listen=127.0.0.1:0"}));
    if (!kAddressSanitizer) {
      const rlimit memory = {rlim_t{24} << 30, RLIM_INFINITY};  // of address space: a waiting learner takes some GiB
      EXPECT_EQ(prlimit(learner->pid(), RLIMIT_AS, &memory, nullptr), 0);
    }
    return learner;
  }
};

// runnable_config_test.cc has the other refusals.
TEST_F(ExtremeConfigsTest, ARunThatNeedsMoreMemoryThanAnyMachineHasIsRefused) {
  const Ended ended = Finish(StartLearner("network { frame_size: 256 } ppo { rollout_steps: 16777216 }").get());
  EXPECT_EQ(ended.exit_code, 1) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("ppo.rollout_steps is 16777216: the learner needs at least"));
  EXPECT_THAT(ended.err, HasSubstr("want "));
  EXPECT_FALSE(PathExists(Logdir("run"))) << "refused before anything is made";
}

class LargestConfigsTest : public ExtremeConfigsTest, public testing::WithParamInterface<const char*> {};

TEST_P(LargestConfigsTest, Start) {
  EXPECT_THAT(StartLearner(GetParam())->WaitForAddress("listening on ", kPatience), IsOk());
}

INSTANTIATE_TEST_SUITE_P(
    Fields, LargestConfigsTest,
    testing::Values(
        "fragment_steps: 4096 ppo { rollout_steps: 65536 minibatch_size: 128 }",
        "gradient_shards: 256 ppo { minibatch_size: 256 }", "lanes: 4096 ppo { rollout_steps: 4096 }",
        "agent: \"ppo_spcnn\" network { frame_size: 18 }",
        "steps: 1000000000000 tile: 256 ppo { epochs: 1000 } checkpoint { every_iterations: 1000000 keep: 1000 }"),
    [](const auto& info) { return absl::StrCat("N", info.index); });

class ExtremeRunsTest : public SmallRunTest {};

// The learner used to refuse what actors made of such weights, for ever.
TEST_F(ExtremeRunsTest, TrainingThatDivergesEndsWithItsReasonAndACheckpointThatResumes) {
  // Normalised values may be smaller by far.
  for (const std::string fields : {"learning_rate: 1", "learning_rate: 0.2  value_norm_decay: 0.9"}) {
    SCOPED_TRACE(fields);
    ASSERT_THAT(WriteFileSynced(config(), absl::StrCat(R"(
      steps: 192  lanes: 4  fragment_steps: 16
      ppo { rollout_steps: 64  minibatch_size: 32  epochs: 1 )",
                                                       fields, " } eval { every_steps: 0  final_episodes: 0 }")),
                IsOk());
    const std::string run = absl::StrCat("run-", fields.size());
    for (const std::vector<std::string>& more : {std::vector<std::string>{}, {"--resume"}}) {
      const Ended ended = Run("craftfleet train", Flags(run, more));
      EXPECT_EQ(ended.exit_code, 1) << ended.err;
      EXPECT_THAT(ended.err, HasSubstr("training diverges"));
      EXPECT_THAT(ended.err, HasSubstr("a smaller ppo.learning_rate"));
    }
    EXPECT_TRUE(PathExists(Checkpoint(run, 0)));
  }
}

}  // namespace
}  // namespace craftfleet
