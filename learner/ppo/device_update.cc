#include "learner/ppo/device_update.h"

#include <algorithm>
#include <exception>
#include <string>
#include <utility>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/aligned_weights.h"
#include "common/agent/device.h"
#include "common/agent/policy_net.h"
#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"
#include "learner/ppo/device_loss.h"
#include "learner/ppo/distillation/device_net.h"
#include "learner/ppo/divergence.h"

namespace craftfleet {
namespace {

// The states of the first `count` Adams: PPO's and, if there are three, those of distillation.
template <typename State>
auto AdamsOf(State* state, size_t count) {
  std::vector adams = {&state->adam, &state->distillation.matching, &state->distillation.prediction};
  adams.resize(count);
  return adams;
}

}  // namespace

DeviceUpdate::DeviceUpdate(AgentSpec spec, const v1::RunConfig& config, at::Device device)
    : spec_(std::move(spec)),
      config_(config.ppo()),
      seed_(config.seed()),
      corrects_lag_(CorrectsLag(config, spec_.network)),
      device_(device),
      network_(MakeNetwork(spec_.network)),
      adams_(config.distillation().every_iterations() > 0 ? 3 : 1, DeviceAdam(config_)) {}

absl::StatusOr<UpdateStats> DeviceUpdate::Run(const Rollout& rollout, const std::vector<std::vector<Minibatch>>& epochs,
                                              const std::function<bool()>& should_stop, const AfterEpochs& after_epochs,
                                              UpdateState* state) {
  CRAFTFLEET_RETURN_IF_ERROR(lost_);
  absl::StatusOr<UpdateStats> stats = absl::InternalError("the update did not run");
  ValueNorm norm;
  try {
    if (snapshot_ == nullptr) Load(*state);
    for (DeviceAdam& adam : adams_) adam.Keep();
    stats = RunEpochs(rollout, epochs, should_stop, after_epochs, &norm);
    if (stats.ok()) snapshot_ = std::make_shared<const DeviceSnapshot>(spec_, weights_.flat);
  } catch (const std::exception& error) {
    stats = DeviceError("update", error.what());
  }
  if (!stats.ok()) {
    Undo(state->value_norm);
    return stats;
  }
  state->value_norm = norm;
  const std::vector<AdamState*> adams = AdamsOf(state, adams_.size());
  for (size_t i = 0; i < adams.size(); ++i) adams[i]->steps = adams_[i].steps();
  return stats;
}

void DeviceUpdate::Undo(const ValueNorm& norm) {
  if (snapshot_ == nullptr) return;  // the host has it
  try {
    weights_.Restore(snapshot_->flat());
    for (DeviceAdam& adam : adams_) adam.Undo();
    SendValueNorm(norm);
  } catch (const std::exception& error) {
    lost_ = DeviceError("undoing an update", error.what());
  }
}

at::Tensor DeviceUpdate::OutputsOf(const DeviceRollout& rollout, const DeviceMinibatch& minibatch,
                                   const NetOutput& output) const {
  const at::Tensor chosen = ChosenActions(rollout.actions.index_select(0, minibatch.rows));
  const at::Tensor log_probs = (output.logits.detach().to(at::kDouble).log_softmax(1) * chosen).sum(1);
  at::Tensor values = output.values.detach().to(at::kDouble);
  if (config_.value_norm_decay() > 0) {
    const DeviceScale scale = value_scale();
    values = values * scale.deviation + scale.mean;
  }
  return at::stack({log_probs, values}, 1).to(at::kFloat);
}

StartOutputs DeviceUpdate::FetchStart(const at::Tensor& outputs) {
  const at::Tensor fetched = outputs.cpu();
  const auto* next = fetched.data_ptr<float>();
  StartOutputs start(outputs.size(0) - 1);
  for (size_t row = 0; row < start.values.size(); ++row) {
    start.log_probs[row] = *next++;
    start.values[row] = *next++;
  }
  return start;
}

void DeviceUpdate::Load(const UpdateState& state) {
  weights_.Load(spec_, state.weights, device_);
  const std::vector<const AdamState*> adams = AdamsOf(&state, adams_.size());
  for (size_t i = 0; i < adams.size(); ++i) {
    const auto& [steps, exp_avg, exp_avg_sq] = *adams[i];
    adams_[i].Load({steps, Align(spec_, exp_avg), Align(spec_, exp_avg_sq)}, device_);
  }
  SendValueNorm(state.value_norm);
  snapshot_ = std::make_shared<const DeviceSnapshot>(spec_, weights_.flat);
}

absl::StatusOr<UpdateStats> DeviceUpdate::RunEpochs(const Rollout& rollout,
                                                    const std::vector<std::vector<Minibatch>>& epochs,
                                                    const std::function<bool()>& should_stop,
                                                    const AfterEpochs& after_epochs, ValueNorm* norm) {
  const int64_t steps_before = adams_[0].steps();
  std::vector<Minibatch> minibatches;
  for (const std::vector<Minibatch>& epoch : epochs) minibatches.insert(minibatches.end(), epoch.begin(), epoch.end());
  minibatches.push_back(TrialSteps(rollout, spec_.network.recurrent()));
  DeviceRollout there = SendRollout(rollout, spec_, device_);
  NormaliseOverRollout(&there);
  at::Tensor start;
  if (corrects_lag_) start = at::zeros({there.actions.size(0), 2}, there.advantages.options());
  UpdateStats stats;
  std::vector<DeviceMinibatch> sent = SendMinibatches(minibatches, rollout, device_);
  const DeviceMinibatch trial = std::move(sent.back());
  sent.pop_back();
  std::vector<at::Tensor> records;
  CorrectedRollout corrected;
  const Rollout* learned = &rollout;
  for (const DeviceMinibatch& minibatch : sent) {
    if (start.defined() && records.size() == epochs[0].size()) {
      corrected = CorrectLag(rollout, FetchStart(start), config_);
      stats.importance = corrected.importance;
      learned = &corrected.rollout;
      SendTargets(*learned, device_, &there);
      NormaliseOverRollout(&there);
      start = at::Tensor();
    }
    records.push_back(RunMinibatch(there, minibatch, start));
    if (should_stop()) return UpdateStopped();
  }
  if (after_epochs != nullptr) CRAFTFLEET_RETURN_IF_ERROR(after_epochs(*learned, &stats));
  const auto count = static_cast<int64_t>(records.size());
  const at::Tensor are_finite = at::isfinite(weights_.flat).all().logical_and(at::isfinite(value_norm_).all());
  // The only wait, but for FetchStart: double[6 * count + 5].
  const at::Tensor fetched = at::cat({at::stack(records).flatten(), are_finite.to(at::kDouble).view({1}),
                                      TryWeights(there, trial), value_norm_})
                                 .cpu();
  const auto* const record = fetched.data_ptr<double>();
  const auto last_epoch = static_cast<int64_t>(epochs.back().size());
  for (int64_t i = 0; i < count; ++i) {
    const double* const means = record + 6 * i;
    CRAFTFLEET_RETURN_IF_ERROR(CheckGradient(means[5], steps_before + i + 1));
    const auto share = 1 / static_cast<double>(count);
    stats.policy_loss += means[0] * share;
    stats.value_loss += means[1] * share;
    stats.entropy += means[2] * share;
    stats.clip_fraction += means[4] * share;
    stats.gradient_norm += means[5] * share;
    if (i >= count - last_epoch) stats.approx_kl += means[3] / static_cast<double>(last_epoch);
  }
  const double* const last = record + 6 * count;
  if (last[0] == 0) return absl::DataLossError("the update's weights or value statistics are not finite");
  *norm = {last[3], last[4], value_weight_};
  const ValueScale scale = norm->Scale(config_.value_norm_start());
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckOutputs(static_cast<float>(last[1]), static_cast<float>(last[2]), AcceptedOutputs(config_, scale)));
  return stats;
}

void DeviceUpdate::NormaliseOverRollout(DeviceRollout* rollout) const {
  if (!config_.advantages_over_rollout()) return;
  at::Tensor of_steps = rollout->advantages.narrow(0, 0, rollout->advantages.size(0) - 1);
  of_steps.copy_(NormaliseOnDevice(of_steps));
}

at::Tensor DeviceUpdate::TryWeights(const DeviceRollout& rollout, const DeviceMinibatch& trial) const {
  const c10::NoGradGuard no_grad;
  return LargestOutputs(Forward(rollout, trial, std::nullopt)).to(at::kDouble);
}

NetOutput DeviceUpdate::Forward(const DeviceRollout& rollout, const DeviceMinibatch& minibatch,
                                const std::optional<Dropout>& dropout) const {
  const at::Tensor frames = ScaleFrames(rollout.frames.index_select(0, minibatch.frame_rows));
  Segments segments = minibatch.segments;
  if (spec_.state_size > 0) segments.states = rollout.states.index_select(0, minibatch.first_states);
  return network_.Forward(weights_.params, frames, segments, dropout);
}

at::Tensor DeviceUpdate::RunMinibatch(const DeviceRollout& rollout, const DeviceMinibatch& minibatch,
                                      const at::Tensor& start) {
  const at::Tensor& rows = minibatch.rows;
  const uint64_t key = KeyedBits(RandomUse::kDropout, seed_, static_cast<uint64_t>(adams_[0].steps()), 0);
  const NetOutput output = Forward(rollout, minibatch, Dropout{key, 0});
  if (start.defined()) start.index_copy_(0, rows, OutputsOf(rollout, minibatch, output));

  at::Tensor returns = rollout.returns.index_select(0, rows);
  if (config_.value_norm_decay() > 0) returns = NormaliseReturns(returns);
  at::Tensor advantages = rollout.advantages.index_select(0, rows);
  if (!config_.advantages_over_rollout()) advantages = NormaliseOnDevice(advantages);
  if (rollout.weights.defined()) advantages = advantages * rollout.weights.index_select(0, rows);
  const DeviceTargets targets = {rollout.actions.index_select(0, rows), rollout.log_probs.index_select(0, rows),
                                 advantages, returns};
  const DeviceLoss loss = PpoLossOnDevice(output.logits.detach(), output.values.detach(), targets, config_);
  torch::autograd::backward({output.logits, output.values}, {loss.by_logits, loss.by_values});
  return at::cat({loss.means, adams_[0].Step(weights_.TakeGradient(), weights_.flat).view({1})});
}

at::Tensor DeviceUpdate::NormaliseReturns(const at::Tensor& returns) {
  const double decay = config_.value_norm_decay();
  const at::Tensor values = returns.to(at::kDouble);
  value_norm_ = value_norm_ * decay + at::stack({values.mean(), values.square().mean()}) * (1 - decay);
  value_weight_ = decay * value_weight_ + (1 - decay);
  const DeviceScale scale = value_scale();
  return ((values - scale.mean) / scale.deviation).to(at::kFloat);
}

DeviceUpdate::DeviceScale DeviceUpdate::value_scale() const {
  if (value_weight_ == 0) {
    return {at::zeros({}, value_norm_.options()), at::full({}, config_.value_norm_start(), value_norm_.options())};
  }
  const at::Tensor corrected = value_norm_ / value_weight_;
  const at::Tensor mean = corrected.select(0, 0);
  return {mean, (corrected.select(0, 1) - mean.square()).clamp_min(ValueNorm::kMinVariance).sqrt()};
}

absl::Status DeviceUpdate::FetchMoments(UpdateState* state) const {
  CRAFTFLEET_RETURN_IF_ERROR(lost_);
  if (snapshot_ == nullptr) return absl::OkStatus();
  try {
    const std::vector<AdamState*> adams = AdamsOf(state, adams_.size());
    for (size_t i = 0; i < adams.size(); ++i) {
      Unalign(spec_, adams_[i].exp_avg().cpu().data_ptr<float>(), &adams[i]->exp_avg);
      Unalign(spec_, adams_[i].exp_avg_sq().cpu().data_ptr<float>(), &adams[i]->exp_avg_sq);
    }
  } catch (const std::exception& error) {
    return DeviceError("fetching the optimiser", error.what());
  }
  return absl::OkStatus();
}

ValueNorm DeviceUpdate::FetchValueNorm() const {
  const at::Tensor fetched = value_norm_.cpu();
  return {fetched.data_ptr<double>()[0], fetched.data_ptr<double>()[1], value_weight_};
}

void DeviceUpdate::SendValueNorm(const ValueNorm& norm) {
  value_norm_ = at::tensor({norm.mean, norm.mean_square}, at::kDouble).to(device_);
  value_weight_ = norm.weight;
}

std::unique_ptr<DistillationNet> DeviceUpdate::MakeDistillationNet() {
  return std::make_unique<DeviceNet>(spec_, device_, &weights_, &adams_[1], &adams_[2]);
}

}  // namespace craftfleet
