// Updates that several learners share out: the bytes of one process, for each kind of agent.

#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ppo/rollout.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/no_tensor_memory.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/ppo/random_fragments.h"
#include "tests/learner/ppo/update_samples.h"
#include "tests/learner/ranks/local_ranks.h"

namespace craftfleet {
namespace rank_update_test {

constexpr int kIterations = 2;

struct Kind {
  std::string name;
  std::string config;
  int ranks = 2;
  friend void PrintTo(const Kind& kind, std::ostream* out) { *out << kind.name; }
};

v1::RunConfig ConfigOf(const std::string& text) {
  v1::RunConfig config = ParseRunConfig(R"(
    seed: 7 lanes: 2 fragment_steps: 8 gradient_shards: 3 network { frame_size: 36 }
    ppo { rollout_steps: 48 minibatch_size: 12 epochs: 1 learning_rate: 1e-3 })",
                                        "common")
                             .value();
  config.MergeFrom(ParseRunConfig(text, "config").value());
  return ResolveRunConfig(config).value();
}

std::vector<Fragment> FragmentsOf(const PpoUpdater& updater) {
  std::vector<Fragment> fragments = RandomFragments(updater, /*lanes=*/2, /*fragments=*/3, /*steps=*/8);
  for (Fragment& fragment : fragments) {
    for (float& reward : fragment.rewards) reward = reward < 0.3F ? 1 : 0;
  }
  return fragments;
}

// Weights and optimiser after some iterations, with the statistics of the last.
std::string Train(PpoUpdater* updater) {
  std::string losses;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const std::vector<Fragment> fragments = FragmentsOf(*updater);
    const auto stats = updater->Update(iteration, RolloutOf(*updater, fragments), NeverStop);
    EXPECT_THAT(stats, IsOk());
    if (!stats.ok()) return "";
    losses.assign(reinterpret_cast<const char*>(&stats->policy_loss), sizeof(double) * 7);
  }
  return *updater->SaveWeights() + *updater->SaveOptimizer() + losses;
}

class RankUpdateTest : public testing::TestWithParam<Kind> {};

TEST_P(RankUpdateTest, GivesTheBytesOfOneProcess) {
  const v1::RunConfig config = ConfigOf(GetParam().config);
  const std::string alone = Train(PpoUpdater::Create(config, 2).value().get());
  InGroup(GetParam().ranks, [&](RankGroup* group) {
    const auto updater = PpoUpdater::Create(config, 1).value();
    updater->ShareOut(group);
    EXPECT_TRUE(Train(updater.get()) == alone) << "rank " << group->rank();
  });
}

INSTANTIATE_TEST_SUITE_P(
    Kinds, RankUpdateTest,
    testing::Values(Kind{"FeedForward", "agent: 'ppo_cnn'", 3},
                    // An eighth of its linear layer is not a multiple of Adam's block.
                    Kind{"OddFrames", "agent: 'ppo_spcnn' network { frame_size: 25 }"},
                    // Some minibatches have fewer segments than shards.
                    Kind{"Recurrent", "agent: 'lstm_cnn' ppo { minibatch_size: 6 }", 3},
                    Kind{"ValueNorm", "agent: 'ppo_resnet' network { extractor: CNN }"},
                    Kind{"Lag", "agent: 'ppo_cnn' overlap: 1 ppo { epochs: 2 }"},
                    Kind{"RecurrentLag", "agent: 'lstm_cnn' overlap: 1 ppo { epochs: 2 minibatch_size: 6 }"},
                    Kind{"Distillation",
                         "agent: 'achievement_distillation' network { extractor: CNN } distillation { "
                         "every_iterations: 2 epochs: 1 minibatch_size: 6 targets: 2 }"}),
    [](const auto& info) { return info.param.name; });

TEST(RankUpdate, AllStopWhenRank0IsAsked) {
  const v1::RunConfig config = ConfigOf("agent: 'ppo_cnn'");
  InGroup(2, [&](RankGroup* group) {
    const auto updater = PpoUpdater::Create(config, 1).value();
    updater->ShareOut(group);
    const std::string before = *updater->SaveWeights();
    const std::vector<Fragment> fragments = FragmentsOf(*updater);
    int asked = 0;
    const auto stop = [&] { return group->rank() == 0 ? ++asked == 2 : true; };
    EXPECT_EQ(updater->Update(0, RolloutOf(*updater, fragments), stop).status().code(), absl::StatusCode::kCancelled);
    EXPECT_TRUE(*updater->SaveWeights() == before);
    EXPECT_TRUE(group->ended().ok());
  });
}

TEST(RankUpdate, LostRankUndoesTheUpdate) {
  const v1::RunConfig config = ConfigOf("agent: 'ppo_cnn'");
  InGroup(2, [&](RankGroup* group) {
    if (group->rank() == 1) return;
    const auto updater = PpoUpdater::Create(config, 1).value();
    updater->ShareOut(group);
    const std::string before = *updater->SaveWeights() + *updater->SaveOptimizer();
    const std::vector<Fragment> fragments = FragmentsOf(*updater);
    const absl::Status lost = absl::UnavailableError("rank 1 is lost");
    group->Leave(lost);
    EXPECT_EQ(updater->Update(0, RolloutOf(*updater, fragments), NeverStop).status(), lost);
    EXPECT_TRUE(*updater->SaveWeights() + *updater->SaveOptimizer() == before);
  });
}

TEST(RankUpdate, WithoutMemoryOnOneRankTheUpdateIsUndoneOnAll) {
  // The forward pass of its first shard, the backward pass, the second shard.
  for (const int allocations : {0, 50, 90}) {
    for (const int failing : {0, 1}) {
      InGroup(2, [&](RankGroup* group) {
        const auto updater = PpoUpdater::Create(ConfigOf("agent: 'ppo_cnn' gradient_shards: 4"), 1).value();
        updater->ShareOut(group);
        const std::vector<Fragment> fragments = FragmentsOf(*updater);
        const Rollout rollout = RolloutOf(*updater, fragments);
        EXPECT_THAT(updater->Update(0, rollout, NeverStop), IsOk());
        const std::string before = *updater->SaveWeights() + *updater->SaveOptimizer();
        {
          std::optional<NoTensorMemory> no_memory;
          if (group->rank() == failing) no_memory.emplace(allocations);
          EXPECT_THAT(updater->Update(1, rollout, NeverStop), StatusIs(absl::StatusCode::kInternal, testing::_))
              << allocations;
          EXPECT_THAT(group->Share(false), IsOk());  // waits for the other
        }
        EXPECT_TRUE(*updater->SaveWeights() + *updater->SaveOptimizer() == before) << allocations;
        EXPECT_THAT(updater->Update(1, rollout, NeverStop), IsOk()) << allocations;
      });
    }
  }
}

// PPO does not train the goal predictor, so the sum has fewer numbers than weights. Ranks that share no memory ended
// with the wrong number.
TEST(RankUpdate, AFirstUpdateThatFailsOnOneRankIsUndoneOnAll) {
  const FileSizeLimit no_shared_memory(1 << 20);
  InGroup(2, [&](RankGroup* group) {
    const auto updater = PpoUpdater::Create(ConfigOf("agent: 'cnn_distillation'"), 1).value();
    updater->ShareOut(group);
    const std::vector<Fragment> fragments = FragmentsOf(*updater);
    const Rollout rollout = RolloutOf(*updater, fragments);
    const std::string before = *updater->SaveWeights();
    {
      std::optional<NoTensorMemory> no_memory;
      if (group->rank() == 1) no_memory.emplace(0);
      EXPECT_THAT(updater->Update(0, rollout, NeverStop), StatusIs(absl::StatusCode::kInternal, testing::_));
      EXPECT_THAT(group->Share(false), IsOk());  // waits for the other
    }
    EXPECT_TRUE(*updater->SaveWeights() == before);
    EXPECT_THAT(updater->Update(0, rollout, NeverStop), IsOk());
  });
}

TEST(RankUpdate, RankWithOtherWeightsIsNamedAndTheUpdateUndone) {
  const v1::RunConfig config = ConfigOf("agent: 'ppo_cnn'");
  InGroup(2, [&](RankGroup* group) {
    v1::RunConfig own = config;
    own.set_seed(7 + group->rank());
    const auto updater = PpoUpdater::Create(own, 1).value();
    updater->ShareOut(group);
    const std::string before = *updater->SaveWeights();
    const std::vector<Fragment> fragments = FragmentsOf(*updater);
    const auto stats = updater->Update(0, RolloutOf(*updater, fragments), NeverStop);
    EXPECT_EQ(stats.status().code(), absl::StatusCode::kDataLoss) << stats.status();
    EXPECT_THAT(std::string(stats.status().message()), testing::HasSubstr("rank 1 has other weights"));
    EXPECT_TRUE(*updater->SaveWeights() == before);
  });
}

}  // namespace rank_update_test
}  // namespace craftfleet
