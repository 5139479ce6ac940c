#include "learner/trainer.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/heap.h"
#include "common/log.h"
#include "common/status_macros.h"
#include "common/wire/fragment_digest.h"
#include "common/wire/status_service.h"
#include "learner/lane_loading.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kProgressTick = absl::Milliseconds(200);
constexpr absl::Duration kSayWaiting = absl::Seconds(15);
constexpr absl::Duration kRoomTick = absl::Seconds(1);  // between two looks for room on a full disk
constexpr int64_t kMaxWaitingBytes = 64 << 20;          // of logs; 100,000 episodes
constexpr int kMaxFailedUpdates = 2;                    // in a row
constexpr size_t kMaxSenders = 16;                      // that are named when an update fails
constexpr size_t kMaxListBytes = 300;                   // of the fragments that one of them sent

// Who sent what of an iteration that can't be learned from: a line each.
std::vector<std::string> DescribeSenders(const std::vector<Fragment>& fragments) {
  struct Sent {
    std::string list;
    float log_prob = 0;  // lowest
    float value = 0;     // largest, without its sign
  };
  std::map<std::string, Sent> senders;
  for (const Fragment& fragment : fragments) {
    Sent& sent = senders[fragment.sender];
    absl::StrAppend(&sent.list, sent.list.empty() ? "" : " ", fragment.lane, "/", fragment.number);
    for (const float log_prob : fragment.log_probs) sent.log_prob = std::min(sent.log_prob, log_prob);
    for (const float value : fragment.values) sent.value = std::max(sent.value, std::abs(value));
  }
  std::vector<std::string> lines;
  for (const auto& [sender, sent] : senders) {
    if (lines.size() == kMaxSenders) {
      lines.push_back(absl::StrFormat("and %d more", senders.size() - kMaxSenders));
      break;
    }
    const bool is_long = sent.list.size() > kMaxListBytes;
    lines.push_back(absl::StrFormat("of %s (lane/fragment): %s%s; log_probs down to %g, values up to %g", sender,
                                    sent.list.substr(0, kMaxListBytes), is_long ? "..." : "", sent.log_prob,
                                    sent.value));
  }
  return lines;
}

}  // namespace

Trainer::Trainer(const v1::RunConfig& config, const v1::CheckpointState& state, std::vector<Fragment> kept,
                 const Parts& parts)
    : config_(config),
      parts_(parts),
      meter_(parts.clock, Activity::kOther),
      kept_(std::move(kept)),
      policy_version_(state.policy_version()),
      lanes_(parts.ledger->Records()),
      train_seconds_(state.train_seconds()),
      checkpoint_time_(parts.clock->Now()) {
  counters_.iteration = state.iteration();
  counters_.env_steps = state.env_steps();
  counters_.start_steps = state.env_steps();
}

absl::Status Trainer::Run() {
  start_ = parts_.clock->Now();
  Show(0);
  PublishWeights();
  absl::Status status = counters_.iteration == 0 ? WriteCheckpoint() : absl::OkStatus();
  while (status.ok() && !finished()) {
    status = RunIteration();
    ReleaseFreeMemory();  // an iteration's frames, twice
  }
  parts_.checkpoints->Close();
  parts_.progress->Finish(counters_.env_steps, parts_.folder->score());
  if (status.ok()) parts_.evaluations->OnEnd(counters_.env_steps, weights_, [this] { return stopping_.load(); });
  if (status.ok() && !stopping_) {
    parts_.ledger->Finish();
    if (parts_.journal != nullptr) parts_.journal->Clear().IgnoreError();  // it is of no use any more
  } else {
    parts_.ledger->Close();
  }
  if (!status.ok() && status.code() != absl::StatusCode::kCancelled) {
    // What it had learned until then must not be lost.
    if (failed_updates_ > 0 && checkpointed_ != counters_.iteration) {
      if (const absl::Status written = WriteCheckpoint(); !written.ok()) LogError("%s", written.message());
    }
    return status;
  }
  return checkpointed_ == counters_.iteration ? absl::OkStatus() : WriteLastCheckpoint();
}

void Trainer::Stop() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    stopped_.NotifyAll();
  }
  parts_.fragments->Close();
}

absl::Status Trainer::RunIteration() {
  const absl::Time begin = parts_.clock->Now();
  {
    const MutexLock lock(&mu_);
    iteration_begin_ = begin;
  }
  meter_.BeginCycle();
  const int64_t iteration = counters_.iteration;
  const int64_t last_fragment = (iteration + 1) * fragments_per_lane();
  std::vector<Fragment> fragments = TakeKept(last_fragment);
  parts_.ledger->OpenIteration(last_fragment, policy_version_);
  meter_.Switch(Activity::kIntake);
  CRAFTFLEET_RETURN_IF_ERROR(Collect(&fragments));
  meter_.Switch(Activity::kOther);

  meter_.Switch(Activity::kUpdate);
  const absl::StatusOr<UpdateStats> stats = Learn(iteration, fragments);
  meter_.Switch(Activity::kOther);
  if (absl::IsCancelled(stats.status())) return stats.status();
  if (!stats.ok()) return UndoIteration(fragments, stats.status());
  failed_updates_ = 0;
  CRAFTFLEET_RETURN_IF_ERROR(FinishIteration(fragments, *stats));
  Show(absl::ToDoubleSeconds(parts_.clock->Now() - begin));
  return absl::OkStatus();
}

absl::StatusOr<UpdateStats> Trainer::Learn(int64_t iteration, const std::vector<Fragment>& fragments) {
  Rollout rollout;
  const RolloutOptions options = parts_.updater->rollout_options();
  for (const Fragment& fragment : fragments) {
    CRAFTFLEET_RETURN_IF_ERROR(AppendFragment(fragment, options, &rollout));
  }
  const auto should_stop = [this] {
    parts_.progress->Update(counters_.env_steps + config_.ppo().rollout_steps(), parts_.folder->score());
    return stopping_.load();
  };
  return parts_.updater->Update(iteration, rollout, should_stop);
}

absl::Status Trainer::UndoIteration(const std::vector<Fragment>& fragments, const absl::Status& error) {
  ++undone_;
  ++failed_updates_;
  const bool again = failed_updates_ < kMaxFailedUpdates;
  LogError("the update of iteration %d failed: %s; it is undone, and %s", counters_.iteration + 1, error.message(),
           again ? "its fragments are played again" : "training ends, since it failed before in the same way");
  for (const std::string& line : DescribeSenders(fragments)) LogError("%s", line);
  if (parts_.journal != nullptr) {
    if (const absl::Status status = parts_.journal->Clear(); !status.ok()) LogError("%s", status.message());
  }
  if (!again) return error;
  parts_.ledger->RewindIteration();
  return absl::OkStatus();
}

std::vector<Fragment> Trainer::TakeKept(int64_t last_fragment) {
  std::vector<Fragment> taken;
  for (Fragment& fragment : kept_) {
    if (fragment.policy_version != policy_version_ || fragment.number >= last_fragment) continue;
    const Permit permit = {fragment.lane, fragment.number, fragment.policy_version};
    fragment.digest = wire::FragmentDigest(fragment);
    fragment.sender = "kept by an earlier start";
    if (parts_.ledger->Restore(permit, fragment.snapshot, fragment.digest)) taken.push_back(std::move(fragment));
  }
  kept_.clear();
  if (!taken.empty()) LogInfo("%d fragments of iteration %d were kept", taken.size(), counters_.iteration + 1);
  if (parts_.journal == nullptr || !taken.empty()) return taken;
  if (const absl::Status status = parts_.journal->Clear(); !status.ok()) LogError("%s", status.message());
  return taken;
}

void Trainer::Keep(const Fragment& fragment) {
  if (parts_.journal == nullptr) return;
  const absl::Status status = parts_.journal->Append(fragment);
  if (!status.ok()) LogError("%s; the rest of this iteration is not kept", status.message());
}

absl::Status Trainer::Collect(std::vector<Fragment>* fragments) {
  const size_t wanted = static_cast<size_t>(config_.lanes()) * fragments_per_lane();
  absl::Time last_news = parts_.clock->Now();
  int64_t resets = parts_.ledger->resets();
  while (true) {
    // Those of lanes that were put back meanwhile are played again.
    if (resets != parts_.ledger->resets()) {
      resets = parts_.ledger->resets();
      DropPutBack(fragments);
    }
    if (fragments->size() >= wanted) break;
    if (stopping_) return absl::CancelledError("stopping");
    std::optional<Fragment> fragment = parts_.fragments->Pop(kProgressTick);
    if (fragment.has_value()) {
      AddFragment(*std::move(fragment), fragments);
      last_news = parts_.clock->Now();
    } else if (parts_.clock->Now() - last_news > kSayWaiting) {
      last_news = parts_.clock->Now();
      LogInfo("waiting for actors: %d of %d fragments are here, %d actors have joined", fragments->size(), wanted,
              parts_.ledger->Actors().size());
    }
    // One that nobody plays for must hear of its successor too.
    if (!fragment.has_value()) CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->CheckOwned());
    ServeCheckpointRequests();
    parts_.progress->Update(counters_.env_steps + static_cast<int64_t>(fragments->size()) * config_.fragment_steps(),
                            parts_.folder->score());
  }
  std::sort(fragments->begin(), fragments->end(), [](const Fragment& a, const Fragment& b) {
    return std::tie(a.lane, a.number) < std::tie(b.lane, b.number);
  });
  return absl::OkStatus();
}

void Trainer::AddFragment(Fragment fragment, std::vector<Fragment>* fragments) {
  if (!parts_.ledger->Counts(fragment.lane, fragment.number, fragment.digest)) return;
  Keep(fragment);
  const auto same = std::find_if(fragments->begin(), fragments->end(), [&](const Fragment& other) {
    return other.lane == fragment.lane && other.number == fragment.number;
  });
  if (same == fragments->end()) {
    fragments->push_back(std::move(fragment));
  } else {
    *same = std::move(fragment);
  }
}

void Trainer::DropPutBack(std::vector<Fragment>* fragments) {
  const auto counts = [this](const Fragment& fragment) {
    return parts_.ledger->Counts(fragment.lane, fragment.number, fragment.digest);
  };
  const auto end = std::stable_partition(fragments->begin(), fragments->end(), counts);
  if (end == fragments->end()) return;
  fragments->erase(end, fragments->end());
  if (parts_.journal == nullptr) return;
  if (const absl::Status status = parts_.journal->Clear(); !status.ok()) LogError("%s", status.message());
  for (const Fragment& fragment : *fragments) Keep(fragment);
}

absl::Status Trainer::FinishIteration(const std::vector<Fragment>& fragments, const UpdateStats& stats) {
  ++counters_.iteration;
  counters_.env_steps += config_.ppo().rollout_steps();
  ++policy_version_;
  lanes_ = parts_.ledger->Records();
  PublishWeights();
  AddToLogs(fragments, stats);
  FlushLogs();
  CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->CheckOwned());
  parts_.evaluations->OnIteration(counters_.env_steps - config_.ppo().rollout_steps(), counters_.env_steps, weights_,
                                  [this] { return stopping_.load(); });
  ServeCheckpointRequests();
  // The last one is written after the last evaluation.
  if (finished()) return absl::OkStatus();
  if (!checkpoint_missed_ && counters_.iteration % config_.checkpoint().every_iterations() != 0) {
    return absl::OkStatus();
  }
  const absl::Status status = WriteCheckpoint();
  checkpoint_missed_ = !status.ok();
  if (!status.ok()) {
    CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->CheckOwned());
    LogError("checkpoint of iteration %d: %s; mend that: training goes on and tries again after the next iteration",
             counters_.iteration.load(), status.message());
  }
  return absl::OkStatus();
}

void Trainer::PublishWeights() {
  weights_ = std::make_shared<const std::string>(parts_.updater->SaveWeights());
  parts_.weights->Publish(policy_version_, weights_);
  counters_.policy_version = policy_version_;
}

void Trainer::AddToLogs(const std::vector<Fragment>& fragments, const UpdateStats& stats) {
  for (const Fragment& fragment : fragments) parts_.folder->AddEpisodes(fragment.episodes);
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
  parts_.folder->AddScalars(counters_.env_steps, scalars);
}

void Trainer::FlushLogs() {
  absl::Status status = parts_.folder->FlushLogs();
  while (!status.ok()) {
    const std::string trouble =
        absl::StrFormat("%s; %d bytes of logs wait for room", status.message(), parts_.folder->waiting_bytes());
    if (parts_.folder->waiting_bytes() < kMaxWaitingBytes) {
      SayNowAndThen(trouble);
      return;
    }
    WaitForRoom(absl::StrCat(trouble, ", and training with them"));
    if (stopping_ || !parts_.folder->CheckOwned().ok()) return;
    status = parts_.folder->FlushLogs();
  }
}

absl::Status Trainer::WriteLastCheckpoint() {
  absl::Status status = WriteCheckpoint();
  while (absl::IsResourceExhausted(status) && !stopping_) {
    WaitForRoom(absl::StrCat(status.message(), "; the run's end is written as soon as there is room"));
    status = WriteCheckpoint();
  }
  return status;
}

void Trainer::WaitForRoom(absl::string_view trouble) {
  SayNowAndThen(trouble);
  const MutexLock lock(&mu_);
  stopped_.WaitFor(&mu_, kRoomTick, [this] { return stopping_.load(); });
}

void Trainer::SayNowAndThen(absl::string_view trouble) {
  if (parts_.clock->Now() - said_ < kSayWaiting) return;
  said_ = parts_.clock->Now();
  LogError("%s; make room on that disk", trouble);
}

void Trainer::ServeCheckpointRequests() {
  if (!parts_.checkpoints->pending()) return;
  const int64_t iteration = counters_.iteration;
  const absl::Status status = checkpointed_ == iteration ? absl::OkStatus() : WriteCheckpoint();
  if (status.ok()) {
    parts_.checkpoints->Answer(iteration);
  } else {
    parts_.checkpoints->Answer(status);
  }
}

absl::Status Trainer::WriteCheckpoint() {
  Checkpoint checkpoint;
  v1::CheckpointState& state = checkpoint.state;
  state.set_iteration(counters_.iteration);
  state.set_env_steps(counters_.env_steps);
  state.set_policy_version(policy_version_);
  state.set_optimizer_steps(parts_.updater->optimizer_steps());
  state.set_train_seconds(train_seconds_ + absl::ToDoubleSeconds(parts_.clock->Now() - start_));
  for (const LaneRecord& lane : lanes_) *state.add_lanes() = ToProto(lane);
  parts_.evaluations->FillCheckpoint(&checkpoint);
  checkpoint.weights = *weights_;
  checkpoint.optimizer = parts_.updater->SaveOptimizer();
  CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->WriteCheckpoint(std::move(checkpoint)));
  checkpointed_ = counters_.iteration;
  const MutexLock lock(&mu_);
  checkpoint_time_ = parts_.clock->Now();
  return absl::OkStatus();
}

int Trainer::fragments_per_lane() const {
  return config_.ppo().rollout_steps() / (config_.lanes() * config_.fragment_steps());
}

void Trainer::Show(double seconds) {
  const ScoreBoard& score = parts_.folder->score();
  const MutexLock lock(&mu_);
  shown_ = {seconds, score.episodes(), score.RecentReward(), score.RecentLength(), score.Score(), score.Unlocked()};
}

void Trainer::FillStatus(v1::StatusReply* reply) const {
  v1::ProcessSummary* summary = reply->mutable_summary();
  wire::FillWork(meter_.Total(), meter_.Recent(), /*threads=*/1, summary);
  wire::FillUsage(summary);
  summary->set_lanes(config_.lanes());
  summary->set_policy_version(counters_.policy_version);
  const MutexLock lock(&mu_);
  if (shown_.iteration_seconds > 0) {
    // An iteration that takes longer than the last one is the slower for it.
    const absl::Duration under_way = parts_.clock->Now() - iteration_begin_;
    summary->set_steps_per_second(config_.ppo().rollout_steps() /
                                  std::max(shown_.iteration_seconds, absl::ToDoubleSeconds(under_way)));
  }
  wire::AddMetric("iteration", static_cast<double>(counters_.iteration), reply);
  wire::AddMetric("env_steps", static_cast<double>(counters_.env_steps), reply);
  wire::AddMetric("env_steps_goal", static_cast<double>(config_.steps()), reply);
  wire::AddMetric("episodes", static_cast<double>(shown_.episodes), reply);
  wire::AddMetric("reward", shown_.reward, reply);
  wire::AddMetric("episode_length", shown_.length, reply);
  wire::AddMetric("crafter_score", shown_.score, reply);
  wire::AddMetric("achievements_unlocked", shown_.unlocked, reply);
  wire::AddMetric("updates_undone", static_cast<double>(undone_.load()), reply);
  wire::AddMetric("checkpoint_age", absl::ToDoubleSeconds(parts_.clock->Now() - checkpoint_time_), reply);
}

}  // namespace craftfleet
