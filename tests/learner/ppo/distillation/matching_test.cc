// Matching on planted data: what an achievement changes in the frames is known.

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/initial_weights.h"
#include "common/agent/torch_setup.h"
#include "common/base/keyed_random.h"
#include "common/config/config.h"
#include "learner/ppo/distillation/distiller.h"
#include "learner/ppo/distillation/sharded_net.h"
#include "learner/ppo/distillation/transport.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/ppo/update_samples.h"

namespace craftfleet {
namespace matching_test {

constexpr int kLanes = 2;
constexpr int kEpisodesEach = 3;  // of a lane in a rollout; whether the last is whole only the next rollout tells
constexpr int kEpisode = 8;       // steps
constexpr int kRows = kLanes * kEpisodesEach * kEpisode;
constexpr int kFrameSize = 36;
constexpr int kKinds = 3;
// The achievements of the episodes, in their order. Those of the shorter ones are in all others, so that every goal
// of the shorter of two episodes has a right match.
constexpr const char* kOrders[kLanes][kEpisodesEach] = {{"AB", "CAB", "BA"}, {"BA", "BCA", "AB"}};

v1::RunConfig Config(int targets) {
  v1::RunConfig config = *ParseRunConfig(R"(
    agent: "achievement_distillation" seed: 7 lanes: 2
    network { extractor: CNN frame_size: 36 memory: false }
    ppo { rollout_steps: 48 minibatch_size: 16 learning_rate: 3e-4 }
    distillation { every_iterations: 1 epochs: 2 minibatch_size: 8 })",
                                         "config");
  config.mutable_distillation()->set_targets(targets);
  return *ResolveRunConfig(config);
}

// The step of an episode that unlocks its goal number `goal`, from 0.
int StepOf(int goal) { return 1 + 2 * goal; }

// A rollout with what it points to. An achievement of kind A, B or C brightens the left, middle or right third of the
// frames after it, in noise.
struct Sample {
  explicit Sample(int number, bool changes = true) {
    for (int row = 0; row < kRows; ++row) {
      const int t = row % kEpisode;
      const std::string order = kOrders[row / kEpisode / kEpisodesEach][row / kEpisode % kEpisodesEach];
      bool lit[kKinds] = {};
      bool unlocks = false;
      for (size_t goal = 0; goal < order.size(); ++goal) {
        lit[order[goal] - 'A'] = changes && t > StepOf(static_cast<int>(goal));
        unlocks = unlocks || t == StepOf(static_cast<int>(goal));
      }
      for (int i = 0; i < 3 * kFrameSize * kFrameSize; ++i) {
        const int column = i / 3 % kFrameSize;
        const double noise = changes ? 60 * ActionNoise(5, number * kRows + row, i) : 0;
        frames.push_back(
            static_cast<char>(static_cast<uint8_t>((lit[column * kKinds / kFrameSize] ? 150 : 0) + noise)));
      }
      rollout.actions.push_back(static_cast<Action>(row % kNumActions));
      rollout.returns.push_back(0);
      rollout.rewards.push_back(unlocks ? 1 : 0);
      rollout.ends.push_back(t + 1 == kEpisode ? StepEnd::kTerminated : StepEnd::kNone);
      rollout.states.push_back(nullptr);
    }
    const size_t bytes = frames.size() / kRows;
    for (int row = 0; row < kRows; ++row) {
      rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&frames[row * bytes]));
    }
  }
  Sample(const Sample&) = delete;
  Sample& operator=(const Sample&) = delete;

  std::string frames;
  Rollout rollout;
};

// A distiller without PPO, and what its weights say of planted episodes that it has not seen.
class Distillation {
 public:
  explicit Distillation(const v1::RunConfig& config)
      : config_(config),
        spec_(*MakeAgentSpec(config_)),
        weights_(InitialWeights(spec_, config_.seed())),
        workers_(1, SetUpTorchThread),
        distiller_(spec_, config_, MakeNet()),
        unseen_(kLanes, spec_.frame_bytes(), 0),
        unseen_net_(MakeNet()),
        steps_(spec_, config_, &unseen_, unseen_net_.get()) {
    SetUpTorchThread();
    EXPECT_THAT(unseen_net_->Begin(&unseen_), IsOk());
    for (AdamState* const adam : {&adams_.matching, &adams_.prediction}) {
      adam->exp_avg.resize(spec_.param_count);
      adam->exp_avg_sq.resize(spec_.param_count);
    }
    for (int i = 0; i < 2; ++i) unseen_.Add(i, Sample(1000 + i).rollout);
  }

  // The phase after the next rollout.
  DistillationStats Run(bool changes = true) {
    UpdateStats stats;
    EXPECT_THAT(distiller_.OnIteration(iteration_, Sample(iteration_, changes).rollout, NeverStop, &norm_, &stats),
                IsOk());
    distiller_.Commit(iteration_++);
    return *stats.distillation;
  }

  // Of changes at achievements in different episodes that were not seen.
  struct Alikeness {
    double same = 0;       // mean cosine of those of one kind
    double different = 0;  // and of two
    double loss = 0;       // mean contrastive loss of a source goal, the same goal of a target and another one of it
  };
  Alikeness Judge() {
    Alikeness sums;
    int same = 0;
    int triples = 0;
    ForEachPair([&](const Episode& a, const Episode& b) {
      for (size_t i = 0; i < a.kinds.size(); ++i) {
        const size_t positive = b.kinds.find(a.kinds[i]);
        if (positive == std::string::npos) continue;
        const double to_same = Cosine(a, i, b, positive);
        sums.same += to_same;
        ++same;
        for (size_t j = 0; j < b.kinds.size(); ++j) {
          if (j == positive) continue;
          const double to_other = Cosine(a, i, b, j);
          sums.different += to_other;
          sums.loss += std::log1p(std::exp((to_other - to_same) / config_.distillation().temperature()));
          ++triples;
        }
      }
    });
    return {sums.same / same, sums.different / triples, sums.loss / triples};
  }

  struct Found {
    int right = 0;     // matches of one kind
    int wrong = 0;     // of two
    int possible = 0;  // right ones
  };
  Found MatchesInUnseen() {
    Found found;
    ForEachPair([&](const Episode& a, const Episode& b) {
      found.possible += static_cast<int>(std::min(a.kinds.size(), b.kinds.size()));
      for (const Match& match : MatchGoals(a.changes, b.changes, a.changes.size() / a.kinds.size(), {}, 0.5)) {
        ++(a.kinds[match.row] == b.kinds[match.column] ? found.right : found.wrong);
      }
    });
    return found;
  }

 private:
  std::unique_ptr<DistillationNet> MakeNet() {
    return std::make_unique<ShardedNet>(spec_, config_, absl::MakeSpan(weights_), &adams_, &workers_);
  }

  struct Episode {
    std::string kinds;           // of its goals
    std::vector<float> changes;  // [goals,F]
  };

  static double Cosine(const Episode& a, size_t goal_of_a, const Episode& b, size_t goal_of_b) {
    const size_t size = a.changes.size() / a.kinds.size();
    const float* const x = &a.changes[goal_of_a * size];
    return std::inner_product(x, x + size, &b.changes[goal_of_b * size], 0.0);
  }

  // Of two different episodes each.
  template <typename Visit>
  void ForEachPair(const Visit& visit) {
    std::vector<Episode> episodes;
    for (const KeptEpisode& kept : unseen_.Episodes()) {
      const int place = kept.rows.front() % kRows / kEpisode;
      episodes.push_back(
          {kOrders[place / kEpisodesEach][place % kEpisodesEach], steps_.ChangesAtGoals({&kept})->values});
      EXPECT_EQ(episodes.back().kinds.size(), kept.goals.size());
    }
    EXPECT_EQ(episodes.size(), 8U) << "all but the first and last of each lane";
    for (size_t i = 0; i < episodes.size(); ++i) {
      for (size_t j = 0; j < episodes.size(); ++j) {
        if (i != j) visit(episodes[i], episodes[j]);
      }
    }
  }

  const v1::RunConfig config_;
  const AgentSpec spec_;
  std::vector<float> weights_;
  WorkerPool workers_;
  DistillationAdams adams_;
  Distiller distiller_;
  KeptRollouts unseen_;
  const std::unique_ptr<DistillationNet> unseen_net_;
  DistillationSteps steps_;
  ValueNorm norm_;
  int iteration_ = 0;
};

// Against a distiller that only predicts, which also brings goals of one kind together but does not part two kinds.
TEST(Matching, LearnsWhatAnAchievementChanges) {
  Distillation matching(Config(/*targets=*/3));
  Distillation predicting(Config(/*targets=*/0));
  const auto before = matching.Judge();
  for (int i = 0; i < 8; ++i) {
    const int episodes = i == 0 ? 2 : 4;  // without the run's first of each lane
    EXPECT_EQ(matching.Run().matching_steps, 2 * episodes) << "each episode has matches with the others";
    EXPECT_EQ(predicting.Run().matching_steps, 0);
  }
  const auto after = matching.Judge();
  const auto without = predicting.Judge();
  EXPECT_GT(after.same - after.different, before.same - before.different + 0.2);
  EXPECT_GT(after.same - after.different, without.same - without.different + 0.2);
  EXPECT_LT(after.loss, before.loss / 3);
  EXPECT_LT(after.loss, without.loss / 3);
  const auto found = matching.MatchesInUnseen();
  EXPECT_EQ(found.right, found.possible);
  EXPECT_EQ(found.wrong, 0);
}

TEST(Matching, GoalsThatChangeNothingTakeNoStep) {
  Distillation distillation(Config(/*targets=*/3));
  for (int i = 0; i < 2; ++i) {
    const DistillationStats stats = distillation.Run(/*changes=*/false);
    EXPECT_EQ(stats.matching_steps, 0);
    EXPECT_GT(stats.prediction_steps, 0);
  }
}

}  // namespace matching_test
}  // namespace craftfleet
