#include "learner/trainer.h"

#include <algorithm>
#include <tuple>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/log.h"
#include "common/status_macros.h"
#include "common/wire/status_service.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kProgressTick = absl::Milliseconds(200);
constexpr absl::Duration kSayWaiting = absl::Seconds(15);

double Seconds(const std::atomic<int64_t>& ns) { return static_cast<double>(ns.load()) * 1e-9; }

}  // namespace

Trainer::Trainer(const v1::RunConfig& config, const v1::CheckpointState& state, const Parts& parts)
    : config_(config),
      parts_(parts),
      policy_version_(state.policy_version()),
      lanes_(parts.ledger->Records()),
      train_seconds_(state.train_seconds()) {
  counters_.iteration = state.iteration();
  counters_.env_steps = state.env_steps();
  counters_.start_steps = state.env_steps();
}

absl::Status Trainer::Run() {
  start_ = parts_.clock->Now();
  PublishWeights();
  absl::Status status = counters_.iteration == 0 ? WriteCheckpoint() : absl::OkStatus();
  while (status.ok() && !finished()) status = RunIteration();
  parts_.progress->Finish(counters_.env_steps, parts_.folder->score());
  if (status.ok()) parts_.evaluations->OnEnd(counters_.env_steps, weights_, [this] { return stopping_.load(); });
  parts_.ledger->Finish();
  if (!status.ok() && status.code() != absl::StatusCode::kCancelled) return status;
  return checkpointed_ == counters_.iteration ? absl::OkStatus() : WriteCheckpoint();
}

void Trainer::Stop() {
  stopping_ = true;
  parts_.fragments->Close();
}

absl::Status Trainer::RunIteration() {
  const int64_t begin = absl::ToUnixNanos(parts_.clock->Now());
  const int64_t iteration = counters_.iteration;
  parts_.ledger->OpenIteration((iteration + 1) * fragments_per_lane(), policy_version_);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Fragment> fragments, Collect());
  const int64_t collected = absl::ToUnixNanos(parts_.clock->Now());

  Rollout rollout;
  const RolloutOptions options = parts_.updater->rollout_options();
  for (const Fragment& fragment : fragments) {
    CRAFTFLEET_RETURN_IF_ERROR(AppendFragment(fragment, options, &rollout));
  }
  const int64_t batched = absl::ToUnixNanos(parts_.clock->Now());
  const auto should_stop = [this] {
    parts_.progress->Update(counters_.env_steps + config_.ppo().rollout_steps(), parts_.folder->score());
    return stopping_.load();
  };
  CRAFTFLEET_ASSIGN_OR_RETURN(const UpdateStats stats, parts_.updater->Update(iteration, rollout, should_stop));
  const int64_t updated = absl::ToUnixNanos(parts_.clock->Now());
  CRAFTFLEET_RETURN_IF_ERROR(FinishIteration(fragments, stats));

  counters_.collect_ns += collected - begin;
  counters_.update_ns += updated - batched;
  counters_.other_ns += (batched - collected) + (absl::ToUnixNanos(parts_.clock->Now()) - updated);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Fragment>> Trainer::Collect() {
  const size_t wanted = static_cast<size_t>(config_.lanes()) * fragments_per_lane();
  std::vector<Fragment> fragments;
  absl::Time last_news = parts_.clock->Now();
  while (fragments.size() < wanted) {
    if (stopping_) return absl::CancelledError("stopping");
    std::optional<Fragment> fragment = parts_.fragments->Pop(kProgressTick);
    if (fragment.has_value()) {
      fragments.push_back(*std::move(fragment));
      last_news = parts_.clock->Now();
    } else if (parts_.clock->Now() - last_news > kSayWaiting) {
      last_news = parts_.clock->Now();
      LogInfo("waiting for actors: %d of %d fragments are here, %d actors have joined", fragments.size(), wanted,
              parts_.ledger->Actors().size());
    }
    parts_.progress->Update(counters_.env_steps + static_cast<int64_t>(fragments.size()) * config_.fragment_steps(),
                            parts_.folder->score());
  }
  std::sort(fragments.begin(), fragments.end(), [](const Fragment& a, const Fragment& b) {
    return std::tie(a.lane, a.number) < std::tie(b.lane, b.number);
  });
  return fragments;
}

absl::Status Trainer::FinishIteration(const std::vector<Fragment>& fragments, const UpdateStats& stats) {
  ++counters_.iteration;
  counters_.env_steps += config_.ppo().rollout_steps();
  ++policy_version_;
  lanes_ = parts_.ledger->Records();
  for (const Fragment& fragment : fragments) {
    unlogged_.insert(unlogged_.end(), fragment.episodes.begin(), fragment.episodes.end());
  }
  PublishWeights();
  WriteLogs(stats);
  parts_.evaluations->OnIteration(counters_.env_steps - config_.ppo().rollout_steps(), counters_.env_steps, weights_,
                                  [this] { return stopping_.load(); });
  // The last one is written after the last evaluation.
  if (finished() || counters_.iteration % config_.checkpoint().every_iterations() != 0) return absl::OkStatus();
  if (absl::Status status = WriteCheckpoint(); !status.ok()) {
    LogError("checkpoint of iteration %d: %s; training goes on and tries again after %d iterations",
             counters_.iteration.load(), status.message(), config_.checkpoint().every_iterations());
  }
  return absl::OkStatus();
}

void Trainer::PublishWeights() {
  weights_ = std::make_shared<const std::string>(parts_.updater->SaveWeights());
  parts_.weights->Publish(policy_version_, weights_);
}

void Trainer::WriteLogs(const UpdateStats& stats) {
  if (absl::Status status = parts_.folder->AddEpisodes(unlogged_); status.ok()) {
    unlogged_.clear();
  } else {
    LogError("%s; %d episodes wait for the next iteration", status.message(), unlogged_.size());
  }
  const ScoreBoard& score = parts_.folder->score();
  const double seconds = absl::ToDoubleSeconds(parts_.clock->Now() - start_);
  const auto steps = static_cast<double>(counters_.env_steps - counters_.start_steps);
  std::vector<Scalar> scalars = {
      {"train/policy_loss", stats.policy_loss},
      {"train/value_loss", stats.value_loss},
      {"train/entropy", stats.entropy},
      {"train/approx_kl", stats.approx_kl},
      {"train/clip_fraction", stats.clip_fraction},
      {"train/gradient_norm", stats.gradient_norm},
      {"train/explained_variance", stats.explained_variance},
      {"rollout/reward", score.RecentReward()},
      {"rollout/length", score.RecentLength()},
      {"rollout/crafter_score", score.Score()},
      {"rollout/achievements_unlocked", static_cast<double>(score.Unlocked())},
      {"rollout/episodes", static_cast<double>(score.episodes())},
      {"time/steps_per_second", seconds > 0 ? steps / seconds : 0},
  };
  if (absl::Status status = parts_.folder->events().AddScalars(counters_.env_steps, scalars); !status.ok()) {
    LogError("%s; curves miss a point", status.message());
  }
}

absl::Status Trainer::WriteCheckpoint() {
  if (!unlogged_.empty()) return absl::ResourceExhaustedError("stats.jsonl lacks episodes that can't be written yet");
  Checkpoint checkpoint;
  v1::CheckpointState& state = checkpoint.state;
  state.set_iteration(counters_.iteration);
  state.set_env_steps(counters_.env_steps);
  state.set_policy_version(policy_version_);
  state.set_optimizer_steps(parts_.updater->optimizer_steps());
  state.set_train_seconds(train_seconds_ + absl::ToDoubleSeconds(parts_.clock->Now() - start_));
  for (const LaneRecord& lane : lanes_) {
    v1::LaneState* message = state.add_lanes();
    message->set_next_fragment(lane.next_fragment);
    message->set_snapshot(lane.snapshot.game);
    message->mutable_state()->Assign(lane.snapshot.state.begin(), lane.snapshot.state.end());
  }
  parts_.evaluations->FillCheckpoint(&checkpoint);
  checkpoint.weights = *weights_;
  checkpoint.optimizer = parts_.updater->SaveOptimizer();
  CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->WriteCheckpoint(std::move(checkpoint)));
  checkpointed_ = counters_.iteration;
  return absl::OkStatus();
}

int Trainer::fragments_per_lane() const {
  return config_.ppo().rollout_steps() / (config_.lanes() * config_.fragment_steps());
}

void Trainer::FillStatus(v1::StatusReply* reply) const {
  const double seconds = Seconds(counters_.collect_ns) + Seconds(counters_.update_ns) + Seconds(counters_.other_ns);
  const auto steps = static_cast<double>(counters_.env_steps - counters_.start_steps);
  wire::AddMetric("iteration", static_cast<double>(counters_.iteration), "", reply);
  wire::AddMetric("env_steps", static_cast<double>(counters_.env_steps), "steps", reply);
  wire::AddMetric("env_steps_total", static_cast<double>(config_.steps()), "steps", reply);
  wire::AddMetric("steps_per_second", seconds > 0 ? steps / seconds : 0, "steps/s", reply);
  wire::AddMetric("collect_time", Seconds(counters_.collect_ns), "s", reply);
  wire::AddMetric("update_time", Seconds(counters_.update_ns), "s", reply);
  wire::AddMetric("other_time", Seconds(counters_.other_ns), "s", reply);
}

}  // namespace craftfleet
