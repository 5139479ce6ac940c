#include "learner/ppo/distillation/distillation_steps.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <utility>

#include "common/base/crafter.h"
#include "common/base/status_macros.h"

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
      code_size_(spec.code_size),
      rollouts_(rollouts),
      net_(net) {}

absl::Status DistillationSteps::KeepPolicy(absl::Span<const KeptEpisode> episodes) {
  std::vector<int> rows;
  for (const KeptEpisode& episode : episodes) rows.insert(rows.end(), episode.rows.begin(), episode.rows.end());
  if (rows.empty()) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> logits, net_->Logits(rows));
  std::vector<float> of_all(static_cast<size_t>(rollouts_->rows()) * kNumActions);
  for (size_t i = 0; i < rows.size(); ++i) {
    std::copy_n(logits.begin() + i * kNumActions, kNumActions, of_all.begin() + int64_t{rows[i]} * kNumActions);
  }
  return net_->SetOldLogits(std::move(of_all));
}

absl::StatusOr<GoalChanges> DistillationSteps::ChangesAtGoals(absl::Span<const KeptEpisode* const> episodes) {
  GoalChanges changes;
  std::vector<FramePair> pairs;
  for (const KeptEpisode* episode : episodes) {
    changes.first.push_back(static_cast<int>(pairs.size()));
    for (const int goal : episode->goals) pairs.push_back({episode->rows[goal], episode->rows[goal + 1]});
  }
  changes.first.push_back(static_cast<int>(pairs.size()));
  CRAFTFLEET_ASSIGN_OR_RETURN(changes.values, net_->Changes(pairs));
  return changes;
}

absl::Status DistillationSteps::Run(DistillationStep step, const std::vector<int>& counts, ValueNorm* value_norm) {
  std::vector<float> returns;
  for (size_t i = 0; i < step.rows.size(); ++i) {
    returns.insert(returns.end(), counts[i], rollouts_->return_of(step.rows[i]));
  }
  ValueScale scale;
  if (ppo_.value_norm_decay() > 0) {
    value_norm->Update(returns, ppo_.value_norm_decay());
    scale = value_norm->Scale();
  }
  for (size_t i = 0; i < step.rows.size(); ++i) {
    step.weights.push_back(static_cast<double>(counts[i]) / static_cast<double>(returns.size()));
    step.targets.push_back(scale.Normalise(rollouts_->return_of(step.rows[i])));
  }
  step.temperature = temperature_;
  return net_->Step(step);
}

absl::Status DistillationSteps::Predict(const PredictionBatch& batch, ValueNorm* value_norm) {
  const KeptEpisode& episode = *batch.episode;
  const int length = static_cast<int>(episode.rows.size());
  DistillationStep step;
  step.loss = DistillationLoss::kPrediction;
  std::vector<int> counts;
  RowIndex index(&step.rows, &counts);
  for (size_t i = 0; i < batch.steps.size(); ++i) {
    const FramePair goal = NextGoal(episode.goals, length, batch.steps[i]);
    step.contrasts.push_back({index.Add(episode.rows[goal.before], 0),
                              goal.after == kNoFrame ? kNoFrame : index.Add(episode.rows[goal.after], 0),
                              index.Add(episode.rows[batch.steps[i]], 1),
                              index.Add(episode.rows[batch.negatives[i]], 1)});
  }
  return Run(std::move(step), counts, value_norm);
}

absl::Status DistillationSteps::Match(const MatchingBatch& batch, ValueNorm* value_norm) {
  const KeptEpisode& source = *batch.source;
  DistillationStep step;
  std::vector<int> counts;
  RowIndex index(&step.rows, &counts);
  for (const MatchedGoal& goal : batch.goals) {
    step.contrasts.push_back({index.Add(source.rows[goal.source], 0), index.Add(source.rows[goal.source + 1], 0),
                              goal.positive, goal.negative});
  }
  for (const int t : batch.kept) index.Add(source.rows[t], 1);
  return Run(std::move(step), counts, value_norm);
}

}  // namespace craftfleet
