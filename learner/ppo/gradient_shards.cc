#include "learner/ppo/gradient_shards.h"

#include <algorithm>
#include <exception>
#include <functional>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>
#include <c10/core/GradMode.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/categorical.h"
#include "common/agent/nets/map_tensors.h"
#include "common/agent/nets/wide_product.h"
#include "common/agent/policy_net.h"
#include "common/base/status_macros.h"
#include "learner/ppo/divergence.h"
#include "learner/ppo/run_parts.h"

namespace craftfleet {
namespace {

// A wide layer's gradient is in as many pieces, which then fit into what the backward passes have given back to the
// pool; in one where that would add its squares in another order than several ranks, which have one.
constexpr int64_t kWidePieces = 8;

absl::Span<float> FloatSpan(const at::Tensor& tensor) {
  return absl::MakeSpan(tensor.data_ptr<float>(), tensor.numel());
}

// The segments of `part` with the states before them; with a memory, each row is a segment.
Segments SegmentsOf(const Rollout& rollout, const Minibatch& part, const AgentSpec& spec) {
  const std::vector<int> lengths = spec.network.memory() ? std::vector<int>(part.rows.size(), 1) : part.lengths;
  Segments segments{lengths, at::zeros({static_cast<int64_t>(lengths.size()), spec.state_size})};
  auto* state = segments.states.data_ptr<float>();
  size_t first = 0;
  for (const int length : lengths) {
    const float* const before = rollout.states[part.rows[first]];
    if (before != nullptr) std::copy_n(before, spec.state_size, state);
    state += spec.state_size;
    first += length;
  }
  return segments;
}

}  // namespace

struct GradientShards::Shard {
  Shard(const AgentSpec& spec, absl::Span<float> weights)
      : net(spec, PolicyNet::Use::kTraining, weights), frames(at::empty({0})) {}

  PolicyNet net;
  at::Tensor frames;  // float[rows,H,W,3], reused
  PpoLossSums sums;   // of the last minibatch
};

GradientShards::GradientShards(const AgentSpec& spec, const v1::PpoConfig& config, int count, absl::Span<float> weights,
                               WorkerPool* workers)
    : spec_(spec), config_(config), no_frame_(spec.frame_bytes()), workers_(workers), shards_(count) {
  for (auto& shard : shards_) {
    shard = std::make_unique<Shard>(spec_, weights);
    shard->net.LeaveWideGradients(true);
  }
}

GradientShards::~GradientShards() = default;

// Ranks add the gradients of single shards.
void GradientShards::ShareOut(RankSums* ranks) {
  ranks_ = ranks;
  for (const auto& shard : shards_) shard->net.LeaveWideGradients(false);
}

absl::StatusOr<PpoLossSums> GradientShards::ComputeGradients(const Rollout& rollout, const ShardedMinibatch& minibatch,
                                                             std::vector<ShardGradient>* gradients) {
  const size_t parts = minibatch.parts.size();
  wide_gradients_.clear();
  absl::Status own = PrepareWeights();
  const ShardRange range = OwnShards(parts);
  if (own.ok()) {
    own = RunParts(workers_, "gradient", range.end - range.begin,
                   [&](int i) { ComputeGradient(rollout, minibatch, range.begin + i); });
  }
  if (ranks_ == nullptr) CRAFTFLEET_RETURN_IF_ERROR(own);
  PpoLossSums sums;
  std::vector<PpoLossSums> losses;
  gradients->clear();
  for (int i = range.begin; own.ok() && i < range.end; ++i) {
    gradients->push_back(shards_[i]->net.gradients());
    losses.push_back(shards_[i]->sums);
    sums.Add(losses.back());
  }
  if (ranks_ != nullptr) {
    CRAFTFLEET_RETURN_IF_ERROR(ranks_->Add(own, gradients, losses, &sums));
  } else {
    CRAFTFLEET_RETURN_IF_ERROR(SumWideGradients(range, gradients));
  }
  return sums;
}

absl::Status GradientShards::SumWideGradients(ShardRange range, std::vector<ShardGradient>* gradients) {
  constexpr int64_t kColumnsAtOnce = 64 * WideProduct<float>::kColumns;
  const auto& layers = shards_.front()->net.wide_factors();
  for (auto layer = layers.rbegin(); layer != layers.rend(); ++layer) {  // the last first: a piece becomes several
    const auto& [weight, factors] = *layer;
    if (!factors->input.defined()) continue;  // it has its gradient already
    const int64_t inputs = factors->input.size(1);
    const int64_t outputs = factors->output_gradient.size(1);
    const int64_t count = outputs * inputs % (kWidePieces * int64_t{kAdamBlock}) == 0 ? kWidePieces : 1;
    for (ShardGradient& gradient : *gradients) gradient.insert(gradient.begin() + weight, count - 1, {});
    std::vector<float*> pieces;
    for (int64_t i = 0; i < count; ++i) {
      wide_gradients_.push_back(PooledTensor({outputs / count, inputs}));
      gradients->front()[weight + i] = FloatSpan(wide_gradients_.back());
      pieces.push_back(gradients->front()[weight + i].data());
    }
    std::vector<const WideFactors*> own;
    for (int i = range.begin; i < range.end; ++i) own.push_back(shards_[i]->net.wide_factors().at(weight).get());
    const auto parts = static_cast<int>((inputs + kColumnsAtOnce - 1) / kColumnsAtOnce);
    CRAFTFLEET_RETURN_IF_ERROR(RunParts(workers_, "gradient", parts, [&](int part) {
      const int64_t begin = part * kColumnsAtOnce;
      WideWeightGradient(own, begin, std::min(begin + kColumnsAtOnce, inputs), pieces);
    }));
  }
  return absl::OkStatus();
}

void GradientShards::WriteStart(const Rollout& rollout, const Minibatch& part, const NetOutput& output,
                                const ValueScale& scale, StartOutputs* start) {
  const float* logits = output.logits.data_ptr<float>();
  const float* values = output.values.data_ptr<float>();
  for (size_t i = 0; i < part.rows.size(); ++i) {
    const int row = part.rows[i];
    if (row == kPadding) continue;
    const auto action = static_cast<int>(rollout.actions[row]);
    start->log_probs[row] = static_cast<float>(Categorical(logits + i * kNumActions).log_probs[action]);
    start->values[row] = scale.Denormalise(values[i]);
  }
}

absl::Status GradientShards::TryWeights(const Rollout& rollout, const ValueRange& accepts) {
  wide_gradients_.clear();
  CRAFTFLEET_RETURN_IF_ERROR(PrepareWeights());
  const c10::NoGradGuard no_grad;
  const Minibatch steps = TrialSteps(rollout, spec_.network.recurrent());
  const at::Tensor largest = LargestOutputs(Forward(rollout, steps, std::nullopt, shards_.front().get()));
  return CheckOutputs(largest[0].item<float>(), largest[1].item<float>(), accepts);
}

ShardRange GradientShards::OwnShards(size_t parts) const {
  const int count = static_cast<int>(parts);
  if (ranks_ == nullptr) return {0, count};
  const ShardRange own = ranks_->OwnShards(static_cast<int>(shards_.size()));
  return {std::min(own.begin, count), std::min(own.end, count)};
}

absl::Status GradientShards::PrepareWeights() {
  for (const auto& shard : shards_) shard->net.UsePrepared(nullptr);  // its memory serves again
  absl::Status status;
  try {
    const auto prepared = shards_.front()->net.Prepare([&](const std::vector<std::function<void()>>& tasks) {
      status = RunParts(workers_, "weights", static_cast<int>(tasks.size()), [&](int i) { tasks[i](); });
    });
    for (const auto& shard : shards_) shard->net.UsePrepared(prepared);
  } catch (const std::exception& error) {  // of LibTorch, or out of memory
    status = absl::InternalError(absl::StrCat("weights: ", error.what()));
  }
  return status;
}

NetOutput GradientShards::Forward(const Rollout& rollout, const Minibatch& part, const std::optional<Dropout>& dropout,
                                  Shard* shard) const {
  shard->frames.resize_({static_cast<int64_t>(part.rows.size()), spec_.frame_size, spec_.frame_size, 3});
  ScaleFrames(Gather(rollout.frames, part.rows, no_frame_.data()), spec_.frame_bytes(),
              shard->frames.data_ptr<float>());
  return shard->net.Forward(shard->frames, SegmentsOf(rollout, part, spec_), dropout);
}

void GradientShards::ComputeGradient(const Rollout& rollout, const ShardedMinibatch& minibatch, size_t number) {
  Shard* const shard = shards_[number].get();
  const Minibatch& part = minibatch.parts[number];
  const size_t first = minibatch.firsts[number];
  shard->net.ClearGradients();  // and what was left of wide ones
  const Dropout dropout{minibatch.dropout_key, static_cast<int64_t>(first)};
  const NetOutput output = Forward(rollout, part, dropout, shard);
  if (minibatch.start != nullptr) WriteStart(rollout, part, output, minibatch.scale, minibatch.start);

  const std::vector<Action> actions = Gather(rollout.actions, part.rows);
  const std::vector<float> log_probs = Gather(rollout.log_probs, part.rows);
  const auto advantages = absl::MakeConstSpan(minibatch.advantages).subspan(first, part.rows.size());
  const auto returns = absl::MakeConstSpan(minibatch.returns).subspan(first, part.rows.size());
  const at::Tensor by_logits = at::empty_like(output.logits);
  const at::Tensor by_values = at::empty_like(output.values);
  shard->sums =
      PpoLoss(FloatSpan(output.logits), FloatSpan(output.values), {actions, log_probs, advantages, returns}, config_,
              static_cast<int>(minibatch.advantages.size()), FloatSpan(by_logits), FloatSpan(by_values));
  torch::autograd::backward({output.logits, output.values}, {by_logits, by_values});
}

}  // namespace craftfleet
