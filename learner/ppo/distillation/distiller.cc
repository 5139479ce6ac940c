#include "learner/ppo/distillation/distiller.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include <absl/cleanup/cleanup.h>

#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"
#include "learner/ppo/distillation/transport.h"
#include "learner/ppo/update_state.h"

namespace craftfleet {
namespace {

// The random choices of one phase, drawn one after the other.
class Draws {
 public:
  Draws(uint64_t seed, int64_t iteration) : seed_(seed), iteration_(static_cast<uint64_t>(iteration)) {}

  // 0..count-1, each equally likely.
  int Below(int count) {
    const uint64_t bits = KeyedBits(RandomUse::kDistillation, seed_, iteration_, next_++);
    return static_cast<int>(UnitInterval(bits) * count);
  }

  // A permutation of 0..count-1, by Fisher and Yates.
  std::vector<int> Permutation(int count) {
    std::vector<int> order(count);
    std::iota(order.begin(), order.end(), 0);
    for (int last = count - 1; last > 0; --last) std::swap(order[last], order[Below(last + 1)]);
    return order;
  }

 private:
  const uint64_t seed_;
  const uint64_t iteration_;
  uint64_t next_ = 0;
};

}  // namespace

// One phase: the episodes and the random choices.
class Distiller::Phase {
 public:
  Phase(const v1::DistillationConfig& config, Draws draws, std::vector<KeptEpisode> episodes, DistillationSteps* steps,
        DistillationNet* net, const std::function<bool()>& should_stop, ValueNorm* value_norm)
      : config_(config),
        draws_(draws),
        episodes_(std::move(episodes)),
        steps_(steps),
        net_(net),
        should_stop_(should_stop),
        value_norm_(value_norm) {}

  absl::StatusOr<DistillationStats> Run() {
    CRAFTFLEET_RETURN_IF_ERROR(steps_->KeepPolicy(episodes_));
    for (int epoch = 0; epoch < config_.epochs(); ++epoch) {
      for (const int source : draws_.Permutation(count())) CRAFTFLEET_RETURN_IF_ERROR(MatchSource(source));
      for (const int episode : draws_.Permutation(count())) CRAFTFLEET_RETURN_IF_ERROR(Predict(episodes_[episode]));
    }
    return Stats();
  }

 private:
  int count() const { return static_cast<int>(episodes_.size()); }

  absl::StatusOr<DistillationStats> Stats() {
    CRAFTFLEET_ASSIGN_OR_RETURN(const DistillationLosses matching, net_->TakeLosses(DistillationLoss::kMatching));
    CRAFTFLEET_ASSIGN_OR_RETURN(const DistillationLosses prediction, net_->TakeLosses(DistillationLoss::kPrediction));
    DistillationStats means = {matching.contrastive / std::max(matching_steps_, 1),
                               prediction.contrastive / std::max(prediction_steps_, 1)};
    const int steps = std::max(matching_steps_ + prediction_steps_, 1);
    means.divergence = (matching.divergence + prediction.divergence) / steps;
    means.value_loss = (matching.value + prediction.value) / steps;
    means.matching_steps = matching_steps_;
    means.prediction_steps = prediction_steps_;
    means.episodes = count();
    return means;
  }

  // The source and up to `targets` others, in random order.
  std::vector<const KeptEpisode*> SourceAndTargets(int source) {
    std::vector<const KeptEpisode*> chosen = {&episodes_[source]};
    std::vector<int> others = draws_.Permutation(count() - 1);
    others.resize(std::min<size_t>(others.size(), config_.targets()));
    // A number from `source` on stands for the next one.
    for (const int other : others) chosen.push_back(&episodes_[other + (other >= source ? 1 : 0)]);
    return chosen;
  }

  // The matches of the source with the targets, each with a random goal of its target as negative.
  MatchingBatch Matches(const KeptEpisode& source, const GoalChanges& changes) {
    const auto size = static_cast<size_t>(steps_->code_size());
    const TransportOptions options = {config_.transport_regularization(), config_.transport_rounds()};
    const auto of_episode = [&](size_t i) {
      return absl::MakeConstSpan(changes.values)
          .subspan(changes.first[i] * size, (changes.first[i + 1] - changes.first[i]) * size);
    };
    MatchingBatch batch;
    batch.source = &source;
    for (size_t i = 1; i + 1 < changes.first.size(); ++i) {
      const int first = changes.first[i];
      for (const Match& match : MatchGoals(of_episode(0), of_episode(i), size, options, config_.match_threshold())) {
        const int negative = draws_.Below(changes.first[i + 1] - first);
        batch.goals.push_back({source.goals[match.row], first + match.column, first + negative});
      }
    }
    return batch;
  }

  absl::Status MatchSource(int number) {
    const std::vector<const KeptEpisode*> chosen = SourceAndTargets(number);
    if (chosen.size() == 1) return absl::OkStatus();
    CRAFTFLEET_ASSIGN_OR_RETURN(const GoalChanges changes, steps_->ChangesAtGoals(chosen));
    MatchingBatch batch = Matches(*chosen[0], changes);
    if (batch.goals.empty()) return absl::OkStatus();
    for (size_t i = 0; i < batch.goals.size(); ++i) {
      batch.kept.push_back(draws_.Below(static_cast<int>(chosen[0]->rows.size())));
    }
    CRAFTFLEET_RETURN_IF_ERROR(steps_->Match(batch, value_norm_));
    ++matching_steps_;
    return CheckStop();
  }

  absl::Status Predict(const KeptEpisode& episode) {
    const int length = static_cast<int>(episode.rows.size());
    const std::vector<int> negatives = draws_.Permutation(length);
    const std::vector<int> order = draws_.Permutation(length);
    for (int first = 0; first < length; first += config_.minibatch_size()) {
      PredictionBatch batch;
      batch.episode = &episode;
      for (int i = first; i < std::min(length, first + config_.minibatch_size()); ++i) {
        batch.steps.push_back(order[i]);
        batch.negatives.push_back(negatives[order[i]]);
      }
      CRAFTFLEET_RETURN_IF_ERROR(steps_->Predict(batch, value_norm_));
      ++prediction_steps_;
      CRAFTFLEET_RETURN_IF_ERROR(CheckStop());
    }
    return absl::OkStatus();
  }

  absl::Status CheckStop() const { return should_stop_() ? UpdateStopped() : absl::OkStatus(); }

  const v1::DistillationConfig& config_;
  Draws draws_;
  const std::vector<KeptEpisode> episodes_;
  DistillationSteps* const steps_;
  DistillationNet* const net_;
  const std::function<bool()>& should_stop_;
  ValueNorm* const value_norm_;
  int matching_steps_ = 0;
  int prediction_steps_ = 0;
};

Distiller::Distiller(const AgentSpec& spec, const v1::RunConfig& config, std::unique_ptr<DistillationNet> net)
    : config_(config.distillation()),
      seed_(config.seed()),
      rollouts_(config.lanes(), spec.frame_bytes(), spec.state_size),
      net_(std::move(net)),
      steps_(spec, config, &rollouts_, net_.get()) {}

absl::Status Distiller::OnIteration(int64_t iteration, const Rollout& rollout, const std::function<bool()>& should_stop,
                                    ValueNorm* value_norm, UpdateStats* stats) {
  rollouts_.Add(iteration, rollout);
  if (!IsDue(iteration)) return absl::OkStatus();
  const absl::Cleanup end = [this] { net_->End(); };
  CRAFTFLEET_RETURN_IF_ERROR(net_->Begin(&rollouts_));
  Phase phase(config_, Draws(seed_, iteration), rollouts_.Episodes(), &steps_, net_.get(), should_stop, value_norm);
  CRAFTFLEET_ASSIGN_OR_RETURN(stats->distillation, phase.Run());
  return absl::OkStatus();
}

void Distiller::Commit(int64_t iteration) {
  if (IsDue(iteration)) rollouts_.Clear();
}

}  // namespace craftfleet
