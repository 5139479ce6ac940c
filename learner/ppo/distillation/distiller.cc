#include "learner/ppo/distillation/distiller.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "common/base/crafter.h"
#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"
#include "learner/ppo/distillation/transport.h"

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

// One phase: the episodes, the policy to keep, the random choices and the sums of losses.
class Distiller::Phase {
 public:
  Phase(const v1::DistillationConfig& config, Draws draws, std::vector<KeptEpisode> episodes, DistillationSteps* steps,
        const std::function<bool()>& should_stop, ValueNorm* value_norm)
      : config_(config),
        draws_(draws),
        episodes_(std::move(episodes)),
        steps_(steps),
        should_stop_(should_stop),
        value_norm_(value_norm) {}

  absl::Status Run(int rows) {
    CRAFTFLEET_RETURN_IF_ERROR(KeepPolicy(rows));
    for (int epoch = 0; epoch < config_.epochs(); ++epoch) {
      for (const int source : draws_.Permutation(count())) CRAFTFLEET_RETURN_IF_ERROR(MatchSource(source));
      for (const int episode : draws_.Permutation(count())) CRAFTFLEET_RETURN_IF_ERROR(Predict(episodes_[episode]));
    }
    return absl::OkStatus();
  }

  DistillationStats stats() const {
    DistillationStats means = stats_;
    means.matching_loss /= std::max(means.matching_steps, 1);
    means.prediction_loss /= std::max(means.prediction_steps, 1);
    const int steps = std::max(means.matching_steps + means.prediction_steps, 1);
    means.divergence /= steps;
    means.value_loss /= steps;
    means.episodes = count();
    return means;
  }

 private:
  int count() const { return static_cast<int>(episodes_.size()); }

  // Computes the logits of the policy as it is now, for all rows that a step may use.
  absl::Status KeepPolicy(int rows) {
    old_logits_.resize(static_cast<size_t>(rows) * kNumActions);
    for (const KeptEpisode& episode : episodes_) {
      CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> logits, steps_->Logits(episode.rows));
      for (size_t t = 0; t < episode.rows.size(); ++t) {
        std::copy_n(logits.begin() + t * kNumActions, kNumActions,
                    old_logits_.begin() + static_cast<int64_t>(episode.rows[t]) * kNumActions);
      }
    }
    return absl::OkStatus();
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

  // The matches of the source with one target, each with a random goal of the target as negative.
  void MatchTarget(const KeptEpisode& source, absl::Span<const float> changes, absl::Span<const float> target_changes,
                   MatchingBatch* batch) {
    const auto size = static_cast<size_t>(steps_->code_size());
    const auto target_goals = static_cast<int>(target_changes.size() / size);
    const TransportOptions options = {config_.transport_regularization(), config_.transport_rounds()};
    for (const Match& match : MatchGoals(changes, target_changes, size, options, config_.match_threshold())) {
      batch->goals.push_back({source.goals[match.row], target_changes.subspan(match.column * size, size),
                              target_changes.subspan(draws_.Below(target_goals) * size, size)});
    }
  }

  absl::Status MatchSource(int number) {
    const std::vector<const KeptEpisode*> chosen = SourceAndTargets(number);
    if (chosen.size() == 1) return absl::OkStatus();
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::vector<float>> changes, steps_->GoalChanges(chosen));
    const KeptEpisode& source = *chosen[0];
    MatchingBatch batch;
    batch.source = &source;
    for (size_t i = 1; i < changes.size(); ++i) MatchTarget(source, changes[0], changes[i], &batch);
    if (batch.goals.empty()) return absl::OkStatus();
    for (size_t i = 0; i < batch.goals.size(); ++i) {
      batch.kept.push_back(draws_.Below(static_cast<int>(source.rows.size())));
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(const DistillationLosses losses, steps_->Match(batch, old_logits_, value_norm_));
    stats_.matching_loss += losses.contrastive;
    ++stats_.matching_steps;
    return Add(losses);
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
      CRAFTFLEET_ASSIGN_OR_RETURN(const DistillationLosses losses, steps_->Predict(batch, old_logits_, value_norm_));
      stats_.prediction_loss += losses.contrastive;
      ++stats_.prediction_steps;
      CRAFTFLEET_RETURN_IF_ERROR(Add(losses));
    }
    return absl::OkStatus();
  }

  absl::Status Add(const DistillationLosses& losses) {
    stats_.divergence += losses.divergence;
    stats_.value_loss += losses.value;
    if (should_stop_()) return absl::CancelledError("distillation was stopped; nothing is changed");
    return absl::OkStatus();
  }

  const v1::DistillationConfig& config_;
  Draws draws_;
  const std::vector<KeptEpisode> episodes_;
  DistillationSteps* const steps_;
  const std::function<bool()>& should_stop_;
  ValueNorm* const value_norm_;
  std::vector<float> old_logits_;  // [rows,17], of the rows of episodes_
  DistillationStats stats_;        // sums
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
  Phase phase(config_, Draws(seed_, iteration), rollouts_.Episodes(), &steps_, should_stop, value_norm);
  absl::Status status = net_->Begin(&rollouts_);
  if (status.ok()) status = phase.Run(rollouts_.rows());
  net_->End();
  CRAFTFLEET_RETURN_IF_ERROR(status);
  stats->distillation = phase.stats();
  return absl::OkStatus();
}

void Distiller::Commit(int64_t iteration) {
  if (IsDue(iteration)) rollouts_.Clear();
}

}  // namespace craftfleet
