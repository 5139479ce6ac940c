#include "learner/ppo/ppo_updater.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/types/span.h>

#include "common/agent/device.h"
#include "common/agent/initial_weights.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/base/check.h"
#include "common/base/crc32c.h"
#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"
#include "learner/ppo/device_update.h"
#include "learner/ppo/distillation/sharded_net.h"
#include "learner/ppo/divergence.h"
#include "learner/ppo/optimizer_file.h"
#include "learner/ppo/ppo_loss.h"

namespace craftfleet {
namespace {

constexpr char kCpuDevice[] = "cpu";
// Before the names of distillation's optimisers.
constexpr char kMatching[] = "matching.";
constexpr char kPrediction[] = "prediction.";

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

// The parts of a minibatch, one after the other.
Minibatch Joined(const std::vector<Minibatch>& parts) {
  Minibatch joined;
  for (const Minibatch& part : parts) {
    joined.rows.insert(joined.rows.end(), part.rows.begin(), part.rows.end());
    joined.lengths.insert(joined.lengths.end(), part.lengths.begin(), part.lengths.end());
  }
  return joined;
}

uint32_t WeightsDigest(const std::vector<float>& weights) {
  return Crc32c({reinterpret_cast<const char*>(weights.data()), weights.size() * sizeof(float)});
}

}  // namespace

absl::StatusOr<std::unique_ptr<PpoUpdater>> PpoUpdater::Create(const v1::RunConfig& config, int threads,
                                                               const std::string& device, Start start) {
  CRAFTFLEET_ASSIGN_OR_RETURN(AgentSpec spec, MakeAgentSpec(config));
  CRAFTFLEET_RETURN_IF_ERROR(CheckPrecision(device, spec.precision));
  return std::unique_ptr<PpoUpdater>(new PpoUpdater(std::move(spec), config, threads, device, start));
}

PpoUpdater::PpoUpdater(AgentSpec spec, const v1::RunConfig& config, int threads, const std::string& device, Start start)
    : spec_(std::move(spec)),
      config_(config.ppo()),
      seed_(config.seed()),
      gradient_shards_(config.gradient_shards()),
      corrects_lag_(CorrectsLag(config, spec_.network)),
      distills_(config.distillation().every_iterations() > 0),
      workers_(threads, SetUpTorchThread),
      state_(FreshState(start == Start::kZeros ? std::vector<float>(spec_.param_count)
                                               : InitialWeights(spec_, seed_, &workers_))),
      device_(device == kCpuDevice ? nullptr : std::make_unique<DeviceUpdate>(spec_, config, at::Device(device))) {
  const auto weights = absl::MakeSpan(state_.weights);
  if (distills_) {
    distiller_ = std::make_unique<Distiller>(
        spec_, config,
        device_ != nullptr ? device_->MakeDistillationNet()
                           : std::make_unique<ShardedNet>(spec_, config, weights, &state_.distillation, &workers_));
  }
  if (device_ != nullptr) return;
  shards_ = std::make_unique<GradientShards>(spec_, config_, gradient_shards_, weights, &workers_);
}

PpoUpdater::~PpoUpdater() = default;

void PpoUpdater::ShareOut(RankGroup* group) {
  ranks_.emplace(spec_, gradient_shards_, group);
  shards_->ShareOut(&*ranks_);
}

PpoUpdater::State PpoUpdater::FreshState(std::vector<float> weights) const {
  const auto fresh = [&] {
    return AdamState{0, std::vector<float>(spec_.param_count), std::vector<float>(spec_.param_count)};
  };
  State state{std::move(weights), fresh(), {}, {}};
  if (distills_) state.distillation = {fresh(), fresh()};
  return state;
}

ValueScale PpoUpdater::value_scale() const { return state_.value_norm.Scale(config_.value_norm_start()); }

RolloutOptions PpoUpdater::rollout_options() const {
  RolloutOptions options;
  options.frame_bytes = spec_.frame_bytes();
  options.state_size = spec_.state_size;
  options.every_state = KeepsEveryState(spec_, config_);
  options.gae = GaeOptionsOf(config_);
  options.value_scale = value_scale();
  return options;
}

absl::StatusOr<UpdateStats> PpoUpdater::Update(int64_t iteration, const Rollout& rollout,
                                               const std::function<bool()>& should_stop) {
  CRAFTFLEET_CHECK(rollout.size() > 0);
  CRAFTFLEET_CHECK(spec_.network.recurrent() || rollout.size() % config_.minibatch_size() == 0);
  SetUpTorchThread();
  if (ranks_.has_value()) ranks_->Begin(should_stop);
  if (device_ != nullptr) return UpdateOnDevice(iteration, rollout, should_stop);
  const auto stops = [&] { return ranks_.has_value() ? ranks_->Stops() : should_stop(); };
  ShareWeights();
  State before{{}, state_.adam, state_.value_norm, state_.distillation};
  absl::StatusOr<UpdateStats> stats = absl::InternalError("the update did not run");
  try {
    stats = RunIteration(iteration, rollout, stops);
  } catch (const std::exception& error) {  // of LibTorch, or out of memory
    stats = absl::InternalError(absl::StrCat("update: ", error.what()));
  }
  if (ranks_.has_value()) {
    const absl::Status agreed = ranks_->group()->Agree(stats.status(), WeightsDigest(state_.weights));
    if (!agreed.ok()) stats = agreed;
  }
  if (!stats.ok()) {
    Undo(std::move(before));
  } else {
    shared_weights_.reset();
  }
  EndDistillation(iteration, stats.ok());
  return stats;
}

void PpoUpdater::EndDistillation(int64_t iteration, bool succeeded) {
  if (distiller_ == nullptr) return;
  if (succeeded) {
    distiller_->Commit(iteration);
  } else {
    distiller_->Undo(iteration);
  }
}

absl::StatusOr<UpdateStats> PpoUpdater::RunIteration(int64_t iteration, const Rollout& rollout,
                                                     const std::function<bool()>& should_stop) {
  CorrectedRollout corrected;
  const Rollout* learned = &rollout;
  CRAFTFLEET_ASSIGN_OR_RETURN(UpdateStats stats, RunEpochs(iteration, should_stop, &corrected, &learned));
  if (distiller_ != nullptr) {
    CRAFTFLEET_RETURN_IF_ERROR(distiller_->OnIteration(iteration, *learned, should_stop, &state_.value_norm, &stats));
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckWeights(rollout));
  return stats;
}

absl::StatusOr<UpdateStats> PpoUpdater::UpdateOnDevice(int64_t iteration, const Rollout& rollout,
                                                       const std::function<bool()>& should_stop) {
  std::vector<std::vector<Minibatch>> epochs(config_.epochs());
  for (int epoch = 0; epoch < config_.epochs(); ++epoch) {
    epochs[epoch] = MakeMinibatches({seed_, iteration, epoch}, rollout);
    // In the order of its parts, so that dropout finds each row where it is on the CPU.
    for (Minibatch& minibatch : epochs[epoch]) {
      minibatch = Joined(CutIntoShards(minibatch, gradient_shards_));
    }
  }
  const auto distil = [&](const Rollout& learned, UpdateStats* stats) {
    ValueNorm norm;
    const bool is_due = distiller_->IsDue(iteration);
    if (is_due) norm = device_->FetchValueNorm();
    CRAFTFLEET_RETURN_IF_ERROR(distiller_->OnIteration(iteration, learned, should_stop, &norm, stats));
    if (is_due) device_->SendValueNorm(norm);
    return absl::OkStatus();
  };
  shared_weights_.reset();
  absl::StatusOr<UpdateStats> stats =
      device_->Run(rollout, epochs, should_stop, distills_ ? DeviceUpdate::AfterEpochs(distil) : nullptr, &state_);
  EndDistillation(iteration, stats.ok());
  if (stats.ok()) stats->explained_variance = ExplainedVariance(rollout);
  return stats;
}

absl::Status PpoUpdater::CheckWeights(const Rollout& rollout) {
  const ValueNorm& norm = state_.value_norm;
  const bool are_finite =
      std::isfinite(norm.mean) && std::isfinite(norm.mean_square) &&
      std::all_of(state_.weights.begin(), state_.weights.end(), [](float weight) { return std::isfinite(weight); });
  if (!are_finite) return absl::DataLossError("the update's weights or value statistics are not finite");
  return shards_->TryWeights(rollout, AcceptedOutputs(config_, value_scale()));
}

std::vector<Minibatch> PpoUpdater::MakeMinibatches(const EpochKey& key, const Rollout& rollout) const {
  const int size = config_.minibatch_size();
  if (!spec_.network.recurrent()) return StepMinibatches(key, static_cast<int>(rollout.size()), size);
  if (config_.recurrent_batches() == v1::PpoConfig::PUBLISHED) return PublishedMinibatches(key, rollout.starts, size);
  return SegmentMinibatches(key, rollout.starts, size);
}

absl::Status PpoUpdater::Combine(StartOutputs* start) {
  if (!ranks_.has_value()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(ranks_->Combine(&start->log_probs));
  return ranks_->Combine(&start->values);
}

absl::StatusOr<UpdateStats> PpoUpdater::RunEpochs(int64_t iteration, const std::function<bool()>& should_stop,
                                                  CorrectedRollout* corrected, const Rollout** rollout) {
  const Rollout& played = **rollout;
  UpdateStats stats;
  int count = 0;
  std::optional<StartOutputs> start;
  if (corrects_lag_) start.emplace(played.size());
  NormaliseOverRollout(played);
  for (int epoch = 0; epoch < config_.epochs(); ++epoch) {
    StartOutputs* const wanted = epoch == 0 && start.has_value() ? &*start : nullptr;
    CRAFTFLEET_RETURN_IF_ERROR(RunEpoch({seed_, iteration, epoch}, **rollout, wanted, should_stop, &stats, &count));
    if (wanted == nullptr) continue;
    CRAFTFLEET_RETURN_IF_ERROR(Combine(wanted));
    *corrected = CorrectLag(played, *wanted, config_);
    stats.importance = corrected->importance;
    *rollout = &corrected->rollout;
    NormaliseOverRollout(**rollout);
  }
  for (double* sum :
       {&stats.policy_loss, &stats.value_loss, &stats.entropy, &stats.clip_fraction, &stats.gradient_norm}) {
    *sum /= count;
  }
  stats.explained_variance = ExplainedVariance(played);
  return stats;
}

absl::Status PpoUpdater::RunEpoch(const EpochKey& key, const Rollout& rollout, StartOutputs* start,
                                  const std::function<bool()>& should_stop, UpdateStats* stats, int* count) {
  const std::vector<Minibatch> minibatches = MakeMinibatches(key, rollout);
  const bool last_epoch = key.epoch + 1 == config_.epochs();
  for (const Minibatch& minibatch : minibatches) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const double approx_kl, RunMinibatch(rollout, minibatch, start, stats));
    if (last_epoch) stats->approx_kl += approx_kl / static_cast<double>(minibatches.size());
    ++*count;
    // Several ranks have agreed on it already, with the gradients.
    if (!ranks_.has_value() && should_stop()) return UpdateStopped();
  }
  return absl::OkStatus();
}

void PpoUpdater::NormaliseOverRollout(const Rollout& rollout) {
  if (!config_.advantages_over_rollout()) return;
  normalised_advantages_ = rollout.advantages;
  Normalise(absl::MakeSpan(normalised_advantages_));
}

ShardedMinibatch PpoUpdater::CutForShards(const Rollout& rollout, const Minibatch& minibatch, StartOutputs* start) {
  ShardedMinibatch batch;
  batch.start = start;
  batch.scale = value_scale();
  batch.parts = CutIntoShards(minibatch, gradient_shards_);
  std::vector<int> rows;
  for (const Minibatch& part : batch.parts) {
    batch.firsts.push_back(rows.size());
    rows.insert(rows.end(), part.rows.begin(), part.rows.end());
  }
  batch.advantages = Gather(config_.advantages_over_rollout() ? normalised_advantages_ : rollout.advantages, rows);
  if (!config_.advantages_over_rollout()) Normalise(absl::MakeSpan(batch.advantages));
  if (!rollout.weights.empty()) {
    const std::vector<float> weights = Gather(rollout.weights, rows, 1.0F);
    for (size_t i = 0; i < weights.size(); ++i) batch.advantages[i] *= weights[i];
  }
  batch.returns = Gather(rollout.returns, rows);
  if (config_.value_norm_decay() > 0) {
    state_.value_norm.Update(batch.returns, config_.value_norm_decay());
    const ValueScale scale = value_scale();
    for (float& target : batch.returns) target = scale.Normalise(target);
  }
  batch.dropout_key = KeyedBits(RandomUse::kDropout, seed_, static_cast<uint64_t>(state_.adam.steps), 0);
  return batch;
}

absl::StatusOr<double> PpoUpdater::RunMinibatch(const Rollout& rollout, const Minibatch& minibatch, StartOutputs* start,
                                                UpdateStats* stats) {
  const ShardedMinibatch batch = CutForShards(rollout, minibatch, start);
  std::vector<ShardGradient> gradients;
  CRAFTFLEET_ASSIGN_OR_RETURN(const PpoLossSums sums, shards_->ComputeGradients(rollout, batch, &gradients));
  const double norm = AdamStep(config_, gradients, absl::MakeSpan(state_.weights), &state_.adam, &workers_);
  CRAFTFLEET_RETURN_IF_ERROR(CheckGradient(norm, state_.adam.steps + 1));
  const auto rows = static_cast<double>(batch.advantages.size());
  stats->policy_loss += sums.policy_loss / rows;
  stats->value_loss += sums.value_loss / rows;
  stats->entropy += sums.entropy / rows;
  stats->clip_fraction += sums.clipped / rows;
  stats->gradient_norm += norm;
  return sums.approx_kl / rows;
}

void PpoUpdater::Restore(State state) {
  // In place: the shards' nets look into the weights.
  std::copy(state.weights.begin(), state.weights.end(), state_.weights.begin());
  state_.adam = std::move(state.adam);
  state_.value_norm = state.value_norm;
  state_.distillation = std::move(state.distillation);
  if (device_ != nullptr) device_->Forget();
  shared_weights_.reset();
}

void PpoUpdater::Undo(State before) {
  before.weights = *LoadWeights(spec_, **shared_weights_->Bytes());
  Restore(std::move(before));
}

std::shared_ptr<const PolicyWeights> PpoUpdater::ShareWeights() {
  if (device_ != nullptr && device_->weights() != nullptr) return device_->weights();
  if (shared_weights_ == nullptr) {
    shared_weights_ = std::make_shared<const HostWeights>(craftfleet::SaveWeights(spec_, state_.weights));
  }
  return shared_weights_;
}

absl::StatusOr<std::string> PpoUpdater::SaveWeights() const {
  if (device_ == nullptr || device_->weights() == nullptr) return craftfleet::SaveWeights(spec_, state_.weights);
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto bytes, device_->weights()->Bytes());
  return *bytes;
}

absl::StatusOr<std::string> PpoUpdater::SaveOptimizer() {
  if (device_ != nullptr) CRAFTFLEET_RETURN_IF_ERROR(device_->FetchMoments(&state_));
  SafeTensors file;
  AddAdam(spec_, "", state_.adam, &file);
  if (config_.value_norm_decay() > 0) AddValueNorm(state_.value_norm, &file);
  if (distiller_ != nullptr) {
    AddAdam(spec_, kMatching, state_.distillation.matching, &file);
    AddAdam(spec_, kPrediction, state_.distillation.prediction, &file);
    distiller_->Save(&file);
  }
  return WriteSafetensors(file);
}

absl::Status PpoUpdater::Load(absl::string_view weights, absl::string_view optimizer) {
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<float> loaded, LoadWeights(spec_, weights));
  CRAFTFLEET_ASSIGN_OR_RETURN(const SafeTensors file, ReadSafetensors(optimizer));
  State state = FreshState(std::move(loaded));
  CRAFTFLEET_ASSIGN_OR_RETURN(state.adam, ReadAdam(spec_, "", file));
  if (config_.value_norm_decay() > 0) {
    CRAFTFLEET_ASSIGN_OR_RETURN(state.value_norm, ReadValueNorm(file));
  }
  if (distiller_ != nullptr) {
    CRAFTFLEET_ASSIGN_OR_RETURN(state.distillation.matching, ReadAdam(spec_, kMatching, file));
    CRAFTFLEET_ASSIGN_OR_RETURN(state.distillation.prediction, ReadAdam(spec_, kPrediction, file));
    CRAFTFLEET_RETURN_IF_ERROR(distiller_->Load(file));
  }
  Restore(std::move(state));
  return absl::OkStatus();
}

absl::Status PpoUpdater::StartFrom(absl::string_view weights, absl::string_view optimizer) {
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<float> loaded, LoadWeights(spec_, weights));
  CRAFTFLEET_ASSIGN_OR_RETURN(const SafeTensors file, ReadSafetensors(optimizer));
  State state = FreshState(std::move(loaded));
  if (config_.value_norm_decay() > 0 && HasValueNorm(file)) {
    CRAFTFLEET_ASSIGN_OR_RETURN(state.value_norm, ReadValueNorm(file));
  }
  Restore(std::move(state));
  return absl::OkStatus();
}

}  // namespace craftfleet
