#include "learner/training/trainer.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/agent/pooled_buffer.h"
#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/process/heap.h"
#include "common/telemetry/log.h"
#include "learner/training/records/lane_loading.h"

namespace craftfleet {
namespace {

constexpr int kMaxFailedUpdates = 2;  // in a row
constexpr size_t kMaxSenders = 16;    // in the log

// Logs who sent `fragments`, with the extremes of their values.
void LogSenders(const std::vector<Fragment>& fragments) {
  struct Sent {
    int fragments = 0;
    float log_prob = 0;  // lowest
    float value = 0;     // largest magnitude
  };
  std::map<std::string, Sent> senders;
  for (const Fragment& fragment : fragments) {
    Sent& sent = senders[fragment.sender];
    ++sent.fragments;
    for (const float log_prob : fragment.log_probs) sent.log_prob = std::min(sent.log_prob, log_prob);
    for (const float value : fragment.values) sent.value = std::max(sent.value, std::abs(value));
  }
  size_t logged = 0;
  for (const auto& [sender, sent] : senders) {
    if (++logged > kMaxSenders) return LogError("and from %d more", senders.size() - kMaxSenders);
    LogError("from %s: %d fragments; log_probs down to %g, values up to %g", sender, sent.fragments, sent.log_prob,
             sent.value);
  }
}

}  // namespace

int KeptVersions(const v1::RunConfig& config) { return 1 + config.overlap() + config.max_staleness(); }

Trainer::Trainer(const v1::RunConfig& config, const Checkpoint& checkpoint, const Parts& parts)
    : config_(config),
      parts_(parts),
      meter_(parts.clock, Activity::kOther),
      status_(config_, &counters_, parts.clock),
      disk_(&stop_, parts.clock),
      log_(parts.folder, &disk_),
      checkpoints_(config.checkpoint().every_iterations(),
                   {parts.folder, parts.checkpoints, &disk_, parts.clock, [this] { return MakeCheckpoint(); }}),
      collector_({parts.registry, parts.fragments, parts.clock}),
      lanes_(parts.registry->lanes()->table().Records()),
      first_version_(checkpoint.state.policy_version()),
      train_seconds_(checkpoint.state.train_seconds()) {
  const v1::CheckpointState& state = checkpoint.state;
  if (state.has_play()) {
    const v1::PlayWeights& play = state.play();
    Publish(play.policy_version(), std::make_shared<const HostWeights>(checkpoint.play_weights),
            {play.value_mean(), play.value_deviation()});
  }
  counters_.iteration = state.iteration();
  counters_.env_steps = state.env_steps();
  counters_.start_steps = state.env_steps();
}

absl::Status Trainer::Run() {
  start_ = parts_.clock->Now();
  status_.OnStart(*parts_.folder);
  PublishWeights(first_version_);
  absl::Status status = counters_.iteration == 0 ? checkpoints_.Write() : absl::OkStatus();
  parts_.evaluations->OnStart(OnWait());
  while (status.ok() && has_steps_left()) {
    status = RunIteration();
    ReleaseFreeMemory();  // up to two copies of an iteration's frames
  }
  parts_.checkpoints->Close();
  parts_.progress->Finish(counters_.env_steps, parts_.folder->score());
  End(/*trained=*/status.ok() && !has_steps_left());
  // A complete run needs the other ranks no longer.
  if (status.ok() && !finished()) status = CheckContinues();
  if (status.ok() || absl::IsCancelled(status)) return checkpoints_.WriteLast(counters_.iteration);
  // Keep what was learned before the error.
  if (failed_updates_ > 0 || !parts_.ranks->lost().ok()) {
    const absl::Status written = checkpoints_.WriteUnlessWritten(counters_.iteration);
    if (!written.ok()) LogError("%s", written.message());
  }
  return status;
}

void Trainer::End(bool trained) {
  if (trained) {
    phase_ = Phase::kEvaluating;
    parts_.evaluations->OnEnd(counters_.env_steps, parts_.updater->ShareWeights(),
                              [this] { return !CheckContinues().ok(); });
    // A checkpoint that was requested during the last iteration has no final evaluation.
    checkpoints_.NoteChange();
  }
  if (trained && parts_.evaluations->pending() == 0) {
    phase_ = Phase::kComplete;
    parts_.registry->Finish();
  } else {
    parts_.registry->Close();
  }
}

std::function<bool()> Trainer::OnWait() {
  return [this] {
    checkpoints_.ServeRequests(counters_.iteration);
    return !CheckContinues().ok();
  };
}

absl::Status Trainer::CheckContinues() const {
  return stop_.is_set() ? absl::CancelledError("stopping") : parts_.ranks->lost();
}

void Trainer::Stop() {
  stop_.Set();
  parts_.fragments->Close();
}

absl::Status Trainer::RunIteration() {
  status_.OnIterationBegin();
  meter_.BeginCycle();
  meter_.Switch(Activity::kIntake);
  Begin();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Fragment> fragments, Collect());
  // Those of an asynchronous run have already advanced, and some may be reset.
  std::vector<LaneRecord> lanes =
      parts_.registry->lanes()->table().Records(is_asynchronous() ? &LaneState::start : &LaneState::record);
  if (config_.overlap() > 0 && has_steps_left(1)) {
    parts_.registry->lanes()->rollouts().OpenIteration(LastFragment(counters_.iteration + 1), counters_.policy_version);
    next_is_open_ = true;
  }
  meter_.Switch(Activity::kUpdate);
  const absl::StatusOr<UpdateStats> stats = Learn(fragments);
  meter_.Switch(Activity::kOther);
  if (absl::IsCancelled(stats.status())) return stats.status();
  if (!stats.ok()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckContinues());
    return UndoIteration(fragments, stats.status());
  }
  // Whatever stops the run now, the updater has the weights of this iteration: a checkpoint must count it.
  failed_updates_ = 0;
  CRAFTFLEET_RETURN_IF_ERROR(FinishIteration(fragments, *stats, std::move(lanes)));
  status_.OnIterationEnd(*parts_.folder, fragments.front(), parts_.updater->spec().frame_size);
  return absl::OkStatus();
}

int64_t Trainer::LastFragment(int64_t iteration) const {
  const int per_lane = config_.ppo().rollout_steps() / (config_.lanes() * config_.fragment_steps());
  return (iteration + 1) * per_lane;
}

void Trainer::Begin() {
  if (std::exchange(next_is_open_, false)) return;
  const int64_t oldest = parts_.weights->Oldest().version;
  if (is_asynchronous()) {
    parts_.registry->lanes()->rollouts().PublishVersion(counters_.policy_version);
  } else {
    parts_.registry->lanes()->rollouts().OpenIteration(LastFragment(counters_.iteration), oldest);
  }
}

absl::StatusOr<std::vector<Fragment>> Trainer::Collect() {
  const auto wanted = static_cast<size_t>(config_.ppo().rollout_steps() / config_.fragment_steps());
  const auto on_tick = [this, wanted](size_t collected, bool is_idle) -> absl::Status {
    CRAFTFLEET_RETURN_IF_ERROR(CheckContinues());
    // Notice a takeover of the folder even without actors.
    if (is_idle) CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->CheckOwned());
    checkpoints_.ServeRequests(counters_.iteration);
    // Of an asynchronous run, some are for later updates.
    const auto played = static_cast<int64_t>(std::min(collected, wanted));
    parts_.progress->Update(counters_.env_steps + played * config_.fragment_steps(), parts_.folder->score());
    return absl::OkStatus();
  };
  return is_asynchronous() ? collector_.CollectRollout(wanted, on_tick) : collector_.Collect(wanted, on_tick);
}

absl::StatusOr<UpdateStats> Trainer::Learn(const std::vector<Fragment>& fragments) {
  Rollout rollout;
  RolloutOptions options = parts_.updater->rollout_options();
  std::vector<ValueScale> scales;
  for (const Fragment& fragment : fragments) {
    const WeightStore::Weights weights = parts_.weights->Find(fragment.policy_version);
    CRAFTFLEET_CHECK(weights.version == fragment.policy_version);
    scales.push_back(weights.value_scale);
    options.value_scale = scales.back();
    AppendFragment(fragment, options, &rollout);
  }
  CRAFTFLEET_RETURN_IF_ERROR(parts_.ranks->ShareUpdate(counters_.iteration, scales, fragments));
  const auto should_stop = [this] {
    parts_.progress->Update(counters_.env_steps + config_.ppo().rollout_steps(), parts_.folder->score());
    return stop_.is_set();
  };
  return parts_.updater->Update(counters_.iteration, rollout, should_stop);
}

absl::Status Trainer::UndoIteration(const std::vector<Fragment>& fragments, const absl::Status& error) {
  ++failed_updates_;
  if (absl::IsUnavailable(error)) {
    LogError("the update of iteration %d failed: %s; training ends", counters_.iteration + 1, error.message());
    return error;
  }
  const bool again = failed_updates_ < kMaxFailedUpdates;
  LogError("the update of iteration %d failed: %s; it is undone, and %s", counters_.iteration + 1, error.message(),
           again ? "its fragments will be played again" : "training ends, since the update has failed twice in a row");
  LogSenders(fragments);
  if (again) {
    parts_.registry->lanes()->rollouts().RewindIterations(next_is_open_ || is_asynchronous() ? 2 : 1);
    next_is_open_ = false;
  }
  status_.OnUpdateUndone();
  return again ? absl::OkStatus() : error;
}

absl::Status Trainer::FinishIteration(const std::vector<Fragment>& fragments, const UpdateStats& stats,
                                      std::vector<LaneRecord> lanes) {
  const int64_t steps_before = counters_.env_steps;
  ++counters_.iteration;
  counters_.env_steps += config_.ppo().rollout_steps();
  lanes_ = std::move(lanes);
  const Staleness staleness = StalenessOf(fragments, counters_.policy_version);
  status_.OnUpdate(staleness);
  PublishWeights(counters_.policy_version + 1);
  log_.AddIteration(counters_.env_steps, fragments, stats, StepsPerSecond());
  if (config_.max_staleness() > 0)
    log_.AddStaleness(counters_.env_steps, staleness, parts_.registry->lanes()->table().counters.dropped);
  log_.Flush();
  CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->CheckOwned());
  // A checkpoint needs as much as the update's activations and what it could have been undone with.
  PooledBuffer::FreeUnused(kMuchFreeMemory);
  ReleaseFreeMemory();
  meter_.Switch(Activity::kIdle);
  parts_.evaluations->OnIteration(steps_before, counters_.env_steps, parts_.updater->ShareWeights(), OnWait());
  meter_.Switch(Activity::kOther);
  checkpoints_.ServeRequests(counters_.iteration);
  // The last checkpoint is written after the final evaluation.
  return has_steps_left() ? checkpoints_.OnIteration(counters_.iteration) : absl::OkStatus();
}

double Trainer::StepsPerSecond() const {
  const double seconds = absl::ToDoubleSeconds(parts_.clock->Now() - start_);
  return seconds > 0 ? static_cast<double>(counters_.env_steps - counters_.start_steps) / seconds : 0;
}

void Trainer::Publish(int64_t version, std::shared_ptr<const PolicyWeights> weights, const ValueScale& value_scale) {
  parts_.weights->Publish(version, std::move(weights), AcceptedOutputs(config_.ppo(), value_scale), value_scale);
}

void Trainer::PublishWeights(int64_t version) {
  std::shared_ptr<const PolicyWeights> weights = parts_.updater->ShareWeights();
  if (parts_.sends_weights) weights->Bytes().IgnoreError();  // who asks for them gets the error
  Publish(version, std::move(weights), parts_.updater->rollout_options().value_scale);
  counters_.policy_version = version;
}

absl::StatusOr<Checkpoint> Trainer::MakeCheckpoint() const {
  Checkpoint checkpoint;
  v1::CheckpointState& state = checkpoint.state;
  state.set_iteration(counters_.iteration);
  state.set_env_steps(counters_.env_steps);
  state.set_policy_version(counters_.policy_version);
  state.set_optimizer_steps(parts_.updater->optimizer_steps());
  state.set_train_seconds(train_seconds_ + absl::ToDoubleSeconds(parts_.clock->Now() - start_));
  for (const LaneRecord& lane : lanes_) *state.add_lanes() = ToProto(lane);
  CRAFTFLEET_RETURN_IF_ERROR(parts_.evaluations->FillCheckpoint(&checkpoint));
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.weights, parts_.updater->ShareWeights()->Bytes());
  const WeightStore::Weights play = parts_.weights->Oldest();
  if (config_.overlap() > 0 && play.version < counters_.policy_version) {
    state.mutable_play()->set_policy_version(play.version);
    state.mutable_play()->set_value_mean(play.value_scale.mean);
    state.mutable_play()->set_value_deviation(play.value_scale.deviation);
    CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.play_weights, play.weights->Bytes());
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.optimizer, parts_.updater->SaveOptimizer());
  return checkpoint;
}

}  // namespace craftfleet
