#include "learner/ppo/distillation/sharded_net.h"

#include <algorithm>
#include <utility>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/code_change.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "learner/ppo/run_parts.h"

namespace craftfleet {
namespace {

constexpr size_t kRowsAtOnce = 64;  // of one shard, without gradients

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

}  // namespace

struct ShardedNet::Shard {
  Shard(const AgentSpec& spec, absl::Span<float> weights)
      : net(spec, PolicyNet::Use::kTraining, weights), frames(at::empty({0})) {}

  PolicyNet net;
  at::Tensor frames;  // float[rows,H,W,3], reused
  NetOutput output;   // of the last forward pass
};

ShardedNet::ShardedNet(const AgentSpec& spec, const v1::RunConfig& config, absl::Span<float> weights,
                       DistillationAdams* adams, WorkerPool* workers)
    : spec_(spec), ppo_(config.ppo()), weights_(weights), adams_(adams), workers_(workers) {
  for (int i = 0; i < config.gradient_shards(); ++i) {
    shards_.push_back(std::make_unique<Shard>(spec_, weights_));
  }
}

ShardedNet::~ShardedNet() = default;

absl::Status ShardedNet::Begin(const KeptRollouts* rollouts) {
  rollouts_ = rollouts;
  matching_sums_ = prediction_sums_ = {};
  return absl::OkStatus();
}

void ShardedNet::LoadFrames(absl::Span<const int> rows, Shard* shard) const {
  std::vector<const uint8_t*> frames;
  frames.reserve(rows.size());
  for (const int row : rows) frames.push_back(rollouts_->frame(row));
  shard->frames.resize_({static_cast<int64_t>(rows.size()), spec_.frame_size, spec_.frame_size, 3});
  ScaleFrames(frames, spec_.frame_bytes(), shard->frames.data_ptr<float>());
}

absl::Status ShardedNet::RunShards(size_t rows, const std::function<void(Shard*, size_t, size_t)>& part) {
  const size_t parts = std::min(shards_.size(), rows);
  return RunParts(workers_, "distillation", static_cast<int>(parts), [&](int i) {
    const size_t first = rows * i / parts;
    part(shards_[i].get(), first, rows * (i + 1) / parts - first);
  });
}

absl::StatusOr<std::vector<float>> ShardedNet::Codes(absl::Span<const int> rows) {
  std::vector<float> codes(rows.size() * spec_.code_size);
  CRAFTFLEET_RETURN_IF_ERROR(RunShards(rows.size(), [&](Shard* shard, size_t first, size_t count) {
    const c10::NoGradGuard no_grad;
    for (size_t done = 0; done < count; done += kRowsAtOnce) {
      LoadFrames(rows.subspan(first + done, std::min(kRowsAtOnce, count - done)), shard);
      CopyRows(shard->net.Codes(shard->frames).cpu(), first + done, &codes);
    }
  }));
  return codes;
}

absl::StatusOr<std::vector<float>> ShardedNet::Changes(absl::Span<const FramePair> pairs) {
  std::vector<int> rows;
  for (const FramePair& pair : pairs) rows.insert(rows.end(), {pair.before, pair.after});
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> codes, Codes(rows));
  const auto size = static_cast<size_t>(spec_.code_size);
  changes_.resize(pairs.size() * size);
  for (size_t i = 0; i < pairs.size(); ++i) {
    const auto of_pair = absl::MakeConstSpan(codes).subspan(2 * i * size, 2 * size);
    CodeChange(of_pair.first(size), of_pair.last(size), absl::MakeSpan(changes_).subspan(i * size, size));
  }
  return changes_;
}

absl::StatusOr<std::vector<float>> ShardedNet::Logits(absl::Span<const int> rows) {
  std::vector<float> logits;
  const c10::NoGradGuard no_grad;
  const size_t at_once = kRowsAtOnce * shards_.size();
  for (size_t done = 0; done < rows.size(); done += at_once) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const NetNumbers outputs, Forward(rows.subspan(done, at_once), /*predicts=*/false));
    logits.insert(logits.end(), outputs.logits.begin(), outputs.logits.end());
  }
  return logits;
}

absl::StatusOr<NetNumbers> ShardedNet::Forward(absl::Span<const int> rows, bool predicts) {
  NetNumbers outputs(rows.size(), spec_.code_size, predicts);
  const bool has_gradients = c10::GradMode::is_enabled();
  CRAFTFLEET_RETURN_IF_ERROR(RunShards(rows.size(), [&](Shard* shard, size_t first, size_t count) {
    const c10::AutoGradMode mode(has_gradients);
    const auto part = rows.subspan(first, count);
    LoadFrames(part, shard);
    const auto n = static_cast<int64_t>(count);
    Segments inputs{std::vector<int>(count, 1), at::zeros({n, spec_.state_size})};
    if (predicts) inputs.actions = at::zeros({n, kNumActions});
    for (size_t i = 0; i < count; ++i) {
      const float* const memory = rollouts_->memory(part[i]);
      if (memory != nullptr) {
        std::copy_n(memory, spec_.state_size, inputs.states.data_ptr<float>() + i * spec_.state_size);
      }
      const auto action = static_cast<size_t>(rollouts_->action(part[i]));
      if (predicts) inputs.actions.data_ptr<float>()[i * kNumActions + action] = 1;
    }
    shard->output = shard->net.Forward(shard->frames, inputs);
    CopyRows(shard->output.logits, first, &outputs.logits);
    CopyRows(shard->output.values, first, &outputs.values);
    CopyRows(shard->output.codes, first, &outputs.codes);
    if (predicts) CopyRows(shard->output.predictions, first, &outputs.predictions);
  }));
  return outputs;
}

absl::Status ShardedNet::Backward(const NetNumbers& gradients) {
  return RunShards(gradients.values.size(), [&](Shard* shard, size_t first, size_t /*count*/) {
    const NetOutput output = std::exchange(shard->output, {});
    std::vector<at::Tensor> outputs = {output.logits, output.values};
    std::vector<at::Tensor> by_outputs = {RowsLike(output.logits, first, gradients.logits),
                                          RowsLike(output.values, first, gradients.values)};
    const bool predicts = !gradients.predictions.empty();
    outputs.push_back(predicts ? output.predictions : output.codes);
    by_outputs.push_back(RowsLike(outputs.back(), first, predicts ? gradients.predictions : gradients.codes));
    shard->net.ClearGradients();
    torch::autograd::backward(outputs, by_outputs);
  });
}

double ShardedNet::StepAdam(size_t rows, AdamState* adam) {
  std::vector<ShardGradient> by_shard;
  for (size_t i = 0; i < std::min(shards_.size(), rows); ++i) by_shard.push_back(shards_[i]->net.gradients());
  return AdamStep(ppo_, by_shard, weights_, adam, workers_);
}

absl::Status ShardedNet::SetOldLogits(std::vector<float> logits) {
  old_logits_ = std::move(logits);
  return absl::OkStatus();
}

absl::Status ShardedNet::Step(const DistillationStep& step) {
  const bool predicts = step.loss == DistillationLoss::kPrediction;
  CRAFTFLEET_ASSIGN_OR_RETURN(const NetNumbers outputs, Forward(step.rows, predicts));
  NetNumbers gradients(step.rows.size(), spec_.code_size, predicts);
  const DistillationLosses losses = StepLosses(step, outputs, changes_, old_logits_, &gradients);
  CRAFTFLEET_RETURN_IF_ERROR(Backward(gradients));
  const double norm = StepAdam(step.rows.size(), predicts ? &adams_->prediction : &adams_->matching);
  CRAFTFLEET_RETURN_IF_ERROR(CheckNorm(norm));
  DistillationLosses* const sums = SumsOf(step.loss);
  sums->contrastive += losses.contrastive;
  sums->divergence += losses.divergence;
  sums->value += losses.value;
  sums->gradient_norm += norm;
  return absl::OkStatus();
}

absl::StatusOr<DistillationLosses> ShardedNet::TakeLosses(DistillationLoss loss) {
  return std::exchange(*SumsOf(loss), {});
}

}  // namespace craftfleet
