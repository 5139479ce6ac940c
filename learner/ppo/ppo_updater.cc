#include "learner/ppo/ppo_updater.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <utility>

#include <ATen/ATen.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/types/span.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/initial_weights.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/status_macros.h"
#include "learner/ppo/minibatches.h"

namespace craftfleet {
namespace {

constexpr char kStepsKey[] = "steps";
constexpr char kExpAvg[] = "exp_avg.";
constexpr char kExpAvgSq[] = "exp_avg_sq.";

absl::Span<float> FloatSpan(const at::Tensor& tensor) {
  return absl::MakeSpan(tensor.data_ptr<float>(), tensor.numel());
}

AdamOptions AdamOptionsOf(const v1::PpoConfig& config) {
  AdamOptions options;
  options.learning_rate = config.learning_rate();
  options.epsilon = config.adam_epsilon();
  options.max_gradient_norm = config.max_gradient_norm();
  return options;
}

double Variance(const std::vector<double>& values) {
  double sum = 0;
  for (const double x : values) sum += x;
  const double mean = sum / values.size();
  double squares = 0;
  for (const double x : values) squares += (x - mean) * (x - mean);
  return squares / values.size();
}

double ExplainedVariance(const Rollout& rollout) {
  std::vector<double> errors;
  for (size_t i = 0; i < rollout.size(); ++i) errors.push_back(double{rollout.returns[i]} - rollout.values[i]);
  const double variance = Variance({rollout.returns.begin(), rollout.returns.end()});
  return variance > 0 ? 1 - Variance(errors) / variance : 0;
}

// The chosen elements of `values`.
template <typename T>
std::vector<T> Gather(const std::vector<T>& values, absl::Span<const int> rows) {
  std::vector<T> chosen;
  chosen.reserve(rows.size());
  for (const int row : rows) chosen.push_back(values[row]);
  return chosen;
}

}  // namespace

struct PpoUpdater::Shard {
  Shard(const AgentSpec& spec, absl::Span<float> weights, int rows)
      : net(spec, PolicyNet::Use::kTraining, weights), frames(at::empty({rows, spec.frame_size, spec.frame_size, 3})) {}

  PolicyNet net;
  at::Tensor frames;    // float[rows,H,W,3]
  PpoLossSums sums;     // of the last minibatch
  absl::Status status;  // likewise
};

absl::StatusOr<std::unique_ptr<PpoUpdater>> PpoUpdater::Create(const v1::RunConfig& config, int threads) {
  CRAFTFLEET_ASSIGN_OR_RETURN(AgentSpec spec, FindAgent(config.agent()));
  if (config.gradient_shards() < 1 || config.ppo().minibatch_size() % config.gradient_shards() != 0) {
    return absl::InvalidArgumentError(absl::StrCat("ppo.minibatch_size is ", config.ppo().minibatch_size(),
                                                   ", want a multiple of gradient_shards, ", config.gradient_shards()));
  }
  return std::unique_ptr<PpoUpdater>(new PpoUpdater(std::move(spec), config, threads));
}

PpoUpdater::PpoUpdater(AgentSpec spec, const v1::RunConfig& config, int threads)
    : spec_(std::move(spec)),
      config_(config.ppo()),
      seed_(config.seed()),
      workers_(threads, SetUpTorchThread),
      weights_(InitialWeights(spec_, seed_)),
      adam_{0, std::vector<float>(spec_.param_count), std::vector<float>(spec_.param_count)} {
  const int rows = config_.minibatch_size() / config.gradient_shards();
  for (int i = 0; i < config.gradient_shards(); ++i) {
    shards_.push_back(std::make_unique<Shard>(spec_, absl::MakeSpan(weights_), rows));
  }
}

PpoUpdater::~PpoUpdater() = default;

absl::StatusOr<UpdateStats> PpoUpdater::Update(int64_t iteration, const Rollout& rollout,
                                               const std::function<bool()>& should_stop) {
  if (rollout.size() == 0 || rollout.size() % config_.minibatch_size() != 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "a rollout of ", rollout.size(), " steps, want a multiple of ppo.minibatch_size, ", config_.minibatch_size()));
  }
  SetUpTorchThread();
  const std::vector<float> weights_before = weights_;
  const AdamState adam_before = adam_;
  absl::StatusOr<UpdateStats> stats = RunEpochs(iteration, rollout, should_stop);
  if (!stats.ok()) {
    std::copy(weights_before.begin(), weights_before.end(), weights_.begin());
    adam_ = adam_before;
  }
  return stats;
}

absl::StatusOr<UpdateStats> PpoUpdater::RunEpochs(int64_t iteration, const Rollout& rollout,
                                                  const std::function<bool()>& should_stop) {
  const int steps = static_cast<int>(rollout.size());
  const int size = config_.minibatch_size();
  const int minibatches = steps / size * config_.epochs();
  UpdateStats stats;
  for (int epoch = 0; epoch < config_.epochs(); ++epoch) {
    const std::vector<int> order = MinibatchOrder(seed_, iteration, epoch, steps);
    for (int first = 0; first < steps; first += size) {
      CRAFTFLEET_ASSIGN_OR_RETURN(const PpoLossSums sums,
                                  RunMinibatch(rollout, absl::MakeSpan(order).subspan(first, size), &stats));
      stats.policy_loss += sums.policy_loss / size / minibatches;
      stats.value_loss += sums.value_loss / size / minibatches;
      stats.entropy += sums.entropy / size / minibatches;
      stats.clip_fraction += sums.clipped / size / minibatches;
      if (epoch + 1 == config_.epochs()) stats.approx_kl += sums.approx_kl / steps;
      if (should_stop()) return absl::CancelledError("the update was stopped; nothing is changed");
    }
  }
  stats.gradient_norm /= minibatches;
  stats.explained_variance = ExplainedVariance(rollout);
  return stats;
}

absl::StatusOr<PpoLossSums> PpoUpdater::RunMinibatch(const Rollout& rollout, absl::Span<const int> rows,
                                                     UpdateStats* stats) {
  std::vector<float> advantages = Gather(rollout.advantages, rows);
  Normalise(absl::MakeSpan(advantages));
  const size_t shard_rows = rows.size() / shards_.size();
  workers_.Run(static_cast<int>(shards_.size()), [&](int i) {
    const size_t first = i * shard_rows;
    ComputeGradient(rollout, rows.subspan(first, shard_rows),
                    absl::MakeConstSpan(advantages).subspan(first, shard_rows), shards_[i].get());
  });
  PpoLossSums sums;
  std::vector<ShardGradient> gradients;
  for (const std::unique_ptr<Shard>& shard : shards_) {
    CRAFTFLEET_RETURN_IF_ERROR(shard->status);
    sums.Add(shard->sums);
    gradients.push_back(shard->net.gradients());
  }
  const double norm = AdamStep(AdamOptionsOf(config_), gradients, absl::MakeSpan(weights_), &adam_, &workers_);
  if (!std::isfinite(norm)) {
    return absl::DataLossError(absl::StrCat("the gradient's norm is ", norm, " at optimiser step ", adam_.steps + 1));
  }
  stats->gradient_norm += norm;
  return sums;
}

void PpoUpdater::ComputeGradient(const Rollout& rollout, absl::Span<const int> rows, absl::Span<const float> advantages,
                                 Shard* shard) {
  try {
    const std::vector<const uint8_t*> frames = Gather(rollout.frames, rows);
    ScaleFrames(frames, spec_.frame_bytes(), shard->frames.data_ptr<float>());
    const PolicyNet::Output output = shard->net.Forward(shard->frames);

    const std::vector<Action> actions = Gather(rollout.actions, rows);
    const std::vector<float> log_probs = Gather(rollout.log_probs, rows);
    const std::vector<float> returns = Gather(rollout.returns, rows);
    const at::Tensor by_logits = at::empty_like(output.logits);
    const at::Tensor by_values = at::empty_like(output.values);
    shard->sums = PpoLoss(FloatSpan(output.logits), FloatSpan(output.values), {actions, log_probs, advantages, returns},
                          {config_.clip(), config_.value_coefficient(), config_.entropy_coefficient()},
                          config_.minibatch_size(), FloatSpan(by_logits), FloatSpan(by_values));
    shard->net.ClearGradients();
    torch::autograd::backward({output.logits, output.values}, {by_logits, by_values});
    shard->status = absl::OkStatus();
  } catch (const std::exception& error) {
    shard->status = absl::InternalError(absl::StrCat("gradient: ", error.what()));
  }
}

std::string PpoUpdater::SaveWeights() const { return craftfleet::SaveWeights(spec_, weights_); }

std::string PpoUpdater::SaveOptimizer() const {
  SafeTensors file{AsTensors(spec_, kExpAvg, adam_.exp_avg), {{kStepsKey, absl::StrCat(adam_.steps)}}};
  for (SafeTensor& tensor : AsTensors(spec_, kExpAvgSq, adam_.exp_avg_sq)) file.tensors.push_back(std::move(tensor));
  return WriteSafetensors(file);
}

absl::Status PpoUpdater::Load(absl::string_view weights, absl::string_view optimizer) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> new_weights, LoadWeights(spec_, weights));
  CRAFTFLEET_ASSIGN_OR_RETURN(const SafeTensors file, ReadSafetensors(optimizer));
  AdamState adam = adam_;
  CRAFTFLEET_RETURN_IF_ERROR(CopyTensors(spec_, kExpAvg, file.tensors, absl::MakeSpan(adam.exp_avg)));
  CRAFTFLEET_RETURN_IF_ERROR(CopyTensors(spec_, kExpAvgSq, file.tensors, absl::MakeSpan(adam.exp_avg_sq)));
  const auto steps = file.metadata.find(kStepsKey);
  if (steps == file.metadata.end() || !absl::SimpleAtoi(steps->second, &adam.steps) || adam.steps < 0) {
    return absl::InvalidArgumentError("the optimiser's metadata \"steps\" is not a count");
  }
  std::copy(new_weights.begin(), new_weights.end(), weights_.begin());
  adam_ = std::move(adam);
  return absl::OkStatus();
}

}  // namespace craftfleet
