#include "learner/ppo/distillation/distillation_steps.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include <absl/strings/str_cat.h>

#include "common/agent/code_change.h"
#include "common/base/status_macros.h"
#include "learner/ppo/distillation/distillation_loss.h"
#include "learner/ppo/distillation/goals.h"

namespace craftfleet {
namespace {

// The rows of `step`, each once, with their place in it. A new row does not count in keeping policy and value.
class RowIndex {
 public:
  RowIndex(std::vector<int>* rows, std::vector<int>* counts) : rows_(rows), counts_(counts) {}

  int Add(int row, int count) {
    const auto [entry, is_new] = places_.emplace(row, static_cast<int>(rows_->size()));
    if (is_new) {
      rows_->push_back(row);
      counts_->push_back(0);
    }
    (*counts_)[entry->second] += count;
    return entry->second;
  }

 private:
  std::map<int, int> places_;  // by row
  std::vector<int>* const rows_;
  std::vector<int>* const counts_;
};

}  // namespace

DistillationSteps::DistillationSteps(const AgentSpec& spec, const v1::RunConfig& config, const KeptRollouts* rollouts,
                                     DistillationNet* net)
    : ppo_(config.ppo()),
      temperature_(config.distillation().temperature()),
      code_size_(CodeSizeOf(spec)),
      rollouts_(rollouts),
      net_(net) {}

absl::StatusOr<std::vector<std::vector<float>>> DistillationSteps::GoalChanges(
    absl::Span<const KeptEpisode* const> episodes) {
  std::vector<int> rows;
  for (const KeptEpisode* episode : episodes) {
    for (const int goal : episode->goals) rows.insert(rows.end(), {episode->rows[goal], episode->rows[goal + 1]});
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> codes, net_->Codes(rows));
  const auto size = static_cast<size_t>(code_size_);
  absl::Span<const float> rest = codes;
  std::vector<std::vector<float>> changes;
  for (const KeptEpisode* episode : episodes) {
    std::vector<float>& of_episode = changes.emplace_back(episode->goals.size() * size);
    for (size_t i = 0; i < episode->goals.size(); ++i) {
      CodeChange(rest.subspan(0, size), rest.subspan(size, size), absl::MakeSpan(of_episode).subspan(i * size, size));
      rest.remove_prefix(2 * size);
    }
  }
  return changes;
}

void DistillationSteps::KeepPolicyAndValue(const Step& step, const NetNumbers& outputs,
                                           const std::vector<float>& old_logits, ValueNorm* value_norm,
                                           NetNumbers* gradients, DistillationLosses* losses) const {
  std::vector<float> returns;
  for (size_t i = 0; i < step.rows.size(); ++i) {
    returns.insert(returns.end(), step.counts[i], rollouts_->return_of(step.rows[i]));
  }
  ValueScale scale;
  if (ppo_.value_norm_decay() > 0) {
    value_norm->Update(returns, ppo_.value_norm_decay());
    scale = value_norm->Scale();
  }
  for (size_t i = 0; i < step.rows.size(); ++i) {
    const double weight = static_cast<double>(step.counts[i]) / static_cast<double>(returns.size());
    const float* const old = &old_logits[static_cast<size_t>(step.rows[i]) * kNumActions];
    losses->divergence +=
        weight * PolicyDivergence(&outputs.logits[i * kNumActions], old, weight, &gradients->logits[i * kNumActions]);
    const double error = double{outputs.values[i]} - scale.Normalise(rollouts_->return_of(step.rows[i]));
    losses->value += weight * error * error;
    gradients->values[i] = static_cast<float>(2 * weight * error);
  }
}

absl::StatusOr<DistillationLosses> DistillationSteps::Run(const Step& step, const Contrast& contrast,
                                                          const std::vector<float>& old_logits, ValueNorm* value_norm) {
  const bool predicts = step.loss == DistillationLoss::kPrediction;
  CRAFTFLEET_ASSIGN_OR_RETURN(const NetNumbers outputs, net_->Forward(step.rows, predicts));
  NetNumbers gradients(step.rows.size(), code_size_, predicts);
  DistillationLosses losses;
  losses.contrastive = contrast(outputs, &gradients);
  KeepPolicyAndValue(step, outputs, old_logits, value_norm, &gradients, &losses);
  CRAFTFLEET_ASSIGN_OR_RETURN(losses.gradient_norm, net_->Step(gradients, step.loss));
  if (!std::isfinite(losses.gradient_norm)) {
    return absl::DataLossError(absl::StrCat("distillation: the gradient's norm is ", losses.gradient_norm));
  }
  return losses;
}

absl::StatusOr<DistillationLosses> DistillationSteps::Predict(const PredictionBatch& batch,
                                                              const std::vector<float>& old_logits,
                                                              ValueNorm* value_norm) {
  const KeptEpisode& episode = *batch.episode;
  const int length = static_cast<int>(episode.rows.size());
  Step step;
  step.loss = DistillationLoss::kPrediction;
  RowIndex index(&step.rows, &step.counts);
  struct Places {
    int before, after, positive, negative;  // of the step's rows; after: kNoFrame
  };
  std::vector<Places> places;
  for (size_t i = 0; i < batch.steps.size(); ++i) {
    const FramePair goal = NextGoal(episode.goals, length, batch.steps[i]);
    places.push_back({index.Add(episode.rows[goal.before], 0),
                      goal.after == kNoFrame ? kNoFrame : index.Add(episode.rows[goal.after], 0),
                      index.Add(episode.rows[batch.steps[i]], 1), index.Add(episode.rows[batch.negatives[i]], 1)});
  }
  const auto size = static_cast<size_t>(code_size_);
  const Contrast contrast = [&](const NetNumbers& outputs, NetNumbers* gradients) {
    std::vector<float> anchors(places.size() * size);
    std::vector<ContrastiveRow> rows;
    for (size_t i = 0; i < places.size(); ++i) {
      const auto [before, after, positive, negative] = places[i];
      CodeChange({outputs.code(before), size},
                 after == kNoFrame ? absl::Span<const float>() : absl::Span<const float>(outputs.code(after), size),
                 absl::MakeSpan(anchors).subspan(i * size, size));
      rows.push_back({&anchors[i * size], outputs.prediction(positive), outputs.prediction(negative), nullptr,
                      gradients->prediction(positive), gradients->prediction(negative)});
    }
    return ContrastiveLoss(rows, code_size_, temperature_);
  };
  return Run(step, contrast, old_logits, value_norm);
}

absl::StatusOr<DistillationLosses> DistillationSteps::Match(const MatchingBatch& batch,
                                                            const std::vector<float>& old_logits,
                                                            ValueNorm* value_norm) {
  const KeptEpisode& source = *batch.source;
  Step step;
  RowIndex index(&step.rows, &step.counts);
  std::vector<std::pair<int, int>> places;  // of the source's frames before and after each goal
  for (const MatchedGoal& goal : batch.goals) {
    places.emplace_back(index.Add(source.rows[goal.source], 0), index.Add(source.rows[goal.source + 1], 0));
  }
  for (const int t : batch.kept) index.Add(source.rows[t], 1);

  const auto size = static_cast<size_t>(code_size_);
  const Contrast contrast = [&](const NetNumbers& outputs, NetNumbers* gradients) {
    std::vector<float> vectors(places.size() * 2 * size);  // the anchor of each goal, and the gradient by it
    std::vector<ContrastiveRow> rows;
    for (size_t i = 0; i < places.size(); ++i) {
      float* const anchor = &vectors[i * 2 * size];
      const float* const before = outputs.code(places[i].first);
      const float* const after = outputs.code(places[i].second);
      for (size_t k = 0; k < size; ++k) anchor[k] = after[k] - before[k];
      const MatchedGoal& goal = batch.goals[i];
      rows.push_back({anchor, goal.positive.data(), goal.negative.data(), anchor + size, nullptr, nullptr});
    }
    const double loss = ContrastiveLoss(rows, code_size_, temperature_);
    for (size_t i = 0; i < places.size(); ++i) {
      float* const by_before = gradients->code(places[i].first);
      float* const by_after = gradients->code(places[i].second);
      for (size_t k = 0; k < size; ++k) {
        by_before[k] -= rows[i].by_anchor[k];
        by_after[k] += rows[i].by_anchor[k];
      }
    }
    return loss;
  };
  return Run(step, contrast, old_logits, value_norm);
}

}  // namespace craftfleet
