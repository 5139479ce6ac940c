#include "learner/ppo/distillation/distillation_steps.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <map>
#include <utility>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>
#include <c10/core/GradMode.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/code_change.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "learner/ppo/distillation/distillation_loss.h"
#include "learner/ppo/distillation/goals.h"

namespace craftfleet {
namespace {

constexpr size_t kRowsAtOnce = 64;  // of one shard, without gradients

int CodeSizeOf(const AgentSpec& spec) {
  // The heads see features and memory.
  for (const ParamSpec& param : spec.params) {
    if (param.name == "value_net.weight") return static_cast<int>(param.shape[1]) - spec.state_size;
  }
  return 0;
}

// Copies float[rows,width] to rows first.. of `all`, float[n,width].
void CopyRows(const at::Tensor& tensor, size_t first, std::vector<float>* all) {
  const at::Tensor contiguous = tensor.detach().contiguous();
  const int64_t width = contiguous.numel() / contiguous.size(0);
  std::copy_n(contiguous.data_ptr<float>(), contiguous.numel(), all->begin() + first * width);
}

// Rows first.. of `all`, as a tensor like `output`.
at::Tensor RowsLike(const at::Tensor& output, size_t first, const std::vector<float>& all) {
  at::Tensor rows = at::empty(output.sizes());
  const int64_t width = rows.numel() / rows.size(0);
  std::copy_n(all.begin() + first * width, rows.numel(), rows.data_ptr<float>());
  return rows;
}

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

struct DistillationSteps::Shard {
  Shard(const AgentSpec& spec, absl::Span<float> weights)
      : net(spec, PolicyNet::Use::kTraining, weights), frames(at::empty({0})) {}

  PolicyNet net;
  at::Tensor frames;  // float[rows,H,W,3], reused
  NetOutput output;   // of the last forward pass
  absl::Status status;
};

struct DistillationSteps::Numbers {
  Numbers(size_t rows, int code_size, bool predicts)
      : logits(rows * kNumActions),
        values(rows),
        codes(rows * code_size),
        predictions(predicts ? rows * code_size : 0),
        width(code_size) {}

  const float* code(int row) const { return &codes[static_cast<size_t>(row) * width]; }
  float* code(int row) { return &codes[static_cast<size_t>(row) * width]; }
  const float* prediction(int row) const { return &predictions[static_cast<size_t>(row) * width]; }
  float* prediction(int row) { return &predictions[static_cast<size_t>(row) * width]; }

  std::vector<float> logits;       // [n,17]
  std::vector<float> values;       // [n]
  std::vector<float> codes;        // [n,width]
  std::vector<float> predictions;  // [n,width], or empty
  int width;
};

DistillationSteps::DistillationSteps(const AgentSpec& spec, const v1::RunConfig& config, const KeptRollouts* rollouts,
                                     absl::Span<float> weights, WorkerPool* workers)
    : spec_(spec),
      ppo_(config.ppo()),
      temperature_(config.distillation().temperature()),
      code_size_(CodeSizeOf(spec)),
      rollouts_(rollouts),
      weights_(weights),
      workers_(workers) {
  for (int i = 0; i < config.gradient_shards(); ++i) {
    shards_.push_back(std::make_unique<Shard>(spec_, weights_));
  }
}

DistillationSteps::~DistillationSteps() = default;

void DistillationSteps::LoadFrames(absl::Span<const int> rows, Shard* shard) const {
  std::vector<const uint8_t*> frames;
  frames.reserve(rows.size());
  for (const int row : rows) frames.push_back(rollouts_->frame(row));
  shard->frames.resize_({static_cast<int64_t>(rows.size()), spec_.frame_size, spec_.frame_size, 3});
  ScaleFrames(frames, spec_.frame_bytes(), shard->frames.data_ptr<float>());
}

absl::Status DistillationSteps::RunShards(size_t rows, const std::function<void(Shard*, size_t, size_t)>& part) {
  const size_t parts = std::min(shards_.size(), rows);
  workers_->Run(static_cast<int>(parts), [&](int i) {
    Shard* const shard = shards_[i].get();
    const size_t first = rows * i / parts;
    try {
      part(shard, first, rows * (i + 1) / parts - first);
      shard->status = absl::OkStatus();
    } catch (const std::exception& error) {
      shard->status = absl::InternalError(absl::StrCat("distillation: ", error.what()));
    }
  });
  for (size_t i = 0; i < parts; ++i) CRAFTFLEET_RETURN_IF_ERROR(shards_[i]->status);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<float>> DistillationSteps::Codes(absl::Span<const int> rows) {
  std::vector<float> codes(rows.size() * code_size_);
  CRAFTFLEET_RETURN_IF_ERROR(RunShards(rows.size(), [&](Shard* shard, size_t first, size_t count) {
    const c10::NoGradGuard no_grad;
    for (size_t done = 0; done < count; done += kRowsAtOnce) {
      LoadFrames(rows.subspan(first + done, std::min(kRowsAtOnce, count - done)), shard);
      CopyRows(shard->net.Codes(shard->frames).cpu(), first + done, &codes);
    }
  }));
  return codes;
}

absl::StatusOr<std::vector<float>> DistillationSteps::Logits(absl::Span<const int> rows) {
  std::vector<float> logits;
  const c10::NoGradGuard no_grad;
  const size_t at_once = kRowsAtOnce * shards_.size();
  for (size_t done = 0; done < rows.size(); done += at_once) {
    const absl::Span<const int> some = rows.subspan(done, at_once);
    CRAFTFLEET_ASSIGN_OR_RETURN(const Numbers outputs, Forward({{some.begin(), some.end()}, {}, /*predicts=*/false}));
    logits.insert(logits.end(), outputs.logits.begin(), outputs.logits.end());
  }
  return logits;
}

absl::StatusOr<std::vector<float>> DistillationSteps::GoalChanges(const KeptEpisode& episode) {
  std::vector<int> rows;
  for (const int goal : episode.goals) rows.insert(rows.end(), {episode.rows[goal], episode.rows[goal + 1]});
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> codes, Codes(rows));
  const auto size = static_cast<size_t>(code_size_);
  const absl::Span<const float> all = codes;
  std::vector<float> changes(episode.goals.size() * size);
  for (size_t i = 0; i < episode.goals.size(); ++i) {
    CodeChange(all.subspan(2 * i * size, size), all.subspan((2 * i + 1) * size, size),
               absl::MakeSpan(changes).subspan(i * size, size));
  }
  return changes;
}

absl::StatusOr<DistillationSteps::Numbers> DistillationSteps::Forward(const Step& step) {
  Numbers outputs(step.rows.size(), code_size_, step.predicts);
  const bool has_gradients = c10::GradMode::is_enabled();
  CRAFTFLEET_RETURN_IF_ERROR(RunShards(step.rows.size(), [&](Shard* shard, size_t first, size_t count) {
    const c10::AutoGradMode mode(has_gradients);
    const auto rows = absl::MakeConstSpan(step.rows).subspan(first, count);
    LoadFrames(rows, shard);
    const auto n = static_cast<int64_t>(count);
    Segments inputs{std::vector<int>(count, 1), at::zeros({n, spec_.state_size})};
    inputs.wants_codes = true;
    if (step.predicts) inputs.actions = at::zeros({n, kNumActions});
    for (size_t i = 0; i < count; ++i) {
      const float* const memory = rollouts_->memory(rows[i]);
      if (memory != nullptr) {
        std::copy_n(memory, spec_.state_size, inputs.states.data_ptr<float>() + i * spec_.state_size);
      }
      const auto action = static_cast<size_t>(rollouts_->action(rows[i]));
      if (step.predicts) inputs.actions.data_ptr<float>()[i * kNumActions + action] = 1;
    }
    shard->output = shard->net.Forward(shard->frames, inputs);
    CopyRows(shard->output.logits, first, &outputs.logits);
    CopyRows(shard->output.values, first, &outputs.values);
    CopyRows(shard->output.codes, first, &outputs.codes);
    if (step.predicts) CopyRows(shard->output.predictions, first, &outputs.predictions);
  }));
  return outputs;
}

absl::Status DistillationSteps::Backward(const Numbers& gradients, size_t rows) {
  return RunShards(rows, [&](Shard* shard, size_t first, size_t /*count*/) {
    const NetOutput output = std::exchange(shard->output, {});
    std::vector<at::Tensor> outputs = {output.logits, output.values};
    std::vector<at::Tensor> by_outputs = {RowsLike(output.logits, first, gradients.logits),
                                          RowsLike(output.values, first, gradients.values)};
    // Predicting does not train the goals' features, nor matching the predictor.
    outputs.push_back(gradients.predictions.empty() ? output.codes : output.predictions);
    by_outputs.push_back(
        RowsLike(outputs.back(), first, gradients.predictions.empty() ? gradients.codes : gradients.predictions));
    shard->net.ClearGradients();
    torch::autograd::backward(outputs, by_outputs);
  });
}

void DistillationSteps::KeepPolicyAndValue(const Step& step, const Numbers& outputs,
                                           const std::vector<float>& old_logits, ValueNorm* value_norm,
                                           Numbers* gradients, DistillationLosses* losses) const {
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
                                                          const std::vector<float>& old_logits, ValueNorm* value_norm,
                                                          AdamState* adam) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const Numbers outputs, Forward(step));
  Numbers gradients(step.rows.size(), code_size_, step.predicts);
  DistillationLosses losses;
  losses.contrastive = contrast(outputs, &gradients);
  KeepPolicyAndValue(step, outputs, old_logits, value_norm, &gradients, &losses);
  CRAFTFLEET_RETURN_IF_ERROR(Backward(gradients, step.rows.size()));
  std::vector<ShardGradient> by_shard;
  for (size_t i = 0; i < std::min(shards_.size(), step.rows.size()); ++i) {
    by_shard.push_back(shards_[i]->net.gradients());
  }
  AdamOptions options;
  options.learning_rate = ppo_.learning_rate();
  options.epsilon = ppo_.adam_epsilon();
  options.max_gradient_norm = ppo_.max_gradient_norm();
  losses.gradient_norm = AdamStep(options, by_shard, weights_, adam, workers_);
  if (!std::isfinite(losses.gradient_norm)) {
    return absl::DataLossError(absl::StrCat("distillation: the gradient's norm is ", losses.gradient_norm));
  }
  return losses;
}

absl::StatusOr<DistillationLosses> DistillationSteps::Predict(const PredictionBatch& batch,
                                                              const std::vector<float>& old_logits,
                                                              ValueNorm* value_norm, AdamState* adam) {
  const KeptEpisode& episode = *batch.episode;
  const int length = static_cast<int>(episode.rows.size());
  Step step;
  step.predicts = true;
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
  const Contrast contrast = [&](const Numbers& outputs, Numbers* gradients) {
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
  return Run(step, contrast, old_logits, value_norm, adam);
}

absl::StatusOr<DistillationLosses> DistillationSteps::Match(const MatchingBatch& batch,
                                                            const std::vector<float>& old_logits, ValueNorm* value_norm,
                                                            AdamState* adam) {
  const KeptEpisode& source = *batch.source;
  Step step;
  RowIndex index(&step.rows, &step.counts);
  std::vector<std::pair<int, int>> places;  // of the source's frames before and after each goal
  std::vector<int> target_rows;             // of the frames before and after the positive, and the negative
  for (const MatchedGoal& goal : batch.goals) {
    places.emplace_back(index.Add(source.rows[goal.source], 0), index.Add(source.rows[goal.source + 1], 0));
    for (const int t : {goal.positive, goal.negative}) {
      target_rows.insert(target_rows.end(), {goal.target->rows[t], goal.target->rows[t + 1]});
    }
  }
  for (const int t : batch.kept) index.Add(source.rows[t], 1);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> target_codes, Codes(target_rows));

  const auto size = static_cast<size_t>(code_size_);
  const Contrast contrast = [&](const Numbers& outputs, Numbers* gradients) {
    // Positive, negative, anchor and the gradient by the anchor of each goal.
    std::vector<float> vectors(places.size() * 4 * size);
    std::vector<ContrastiveRow> rows;
    for (size_t i = 0; i < places.size(); ++i) {
      float* const positive = &vectors[i * 4 * size];
      float* const negative = positive + size;
      float* const anchor = negative + size;
      const absl::Span<const float> codes = absl::MakeConstSpan(target_codes).subspan(i * 4 * size, 4 * size);
      CodeChange(codes.subspan(0, size), codes.subspan(size, size), {positive, size});
      CodeChange(codes.subspan(2 * size, size), codes.subspan(3 * size, size), {negative, size});
      const float* const before = outputs.code(places[i].first);
      const float* const after = outputs.code(places[i].second);
      for (size_t k = 0; k < size; ++k) anchor[k] = after[k] - before[k];
      rows.push_back({anchor, positive, negative, anchor + size, nullptr, nullptr});
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
  return Run(step, contrast, old_logits, value_norm, adam);
}

}  // namespace craftfleet
