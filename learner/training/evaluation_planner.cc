#include "learner/training/evaluation_planner.h"

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "common/base/clock.h"
#include "common/base/seeds.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kTick = absl::Milliseconds(200);
constexpr absl::Duration kReportEvery = absl::Seconds(15);
constexpr size_t kAnyNumber = std::numeric_limits<size_t>::max();

}  // namespace

EvaluationPlanner::EvaluationPlanner(const v1::EvalConfig& config, int64_t steps, const Checkpoint& checkpoint,
                                     WorkerRegistry* registry, RunFolder* folder)
    : config_(config),
      registry_(registry),
      folder_(folder),
      begun_(checkpoint.state.evaluations()),
      next_episode_(std::max<int64_t>(checkpoint.state.next_eval_episode(), 1)),
      final_evaluation_steps_(checkpoint.state.final_evaluation_steps()) {
  for (int i = 0; i < checkpoint.state.pending_size(); ++i) {
    const v1::PendingEvaluation& pending = checkpoint.state.pending(i);
    if (pending.final() && checkpoint.state.env_steps() < steps) {
      final_evaluation_steps_ = 0;
      continue;
    }
    registry_->evaluations()->Add({pending.number(), pending.env_steps(), pending.first_episode(), pending.episodes(),
                                   pending.final(),
                                   std::make_shared<const HostWeights>(checkpoint.evaluation_weights[i])});
  }
}

void EvaluationPlanner::OnStart(const std::function<bool()>& should_stop) { LogFinished(kMaxPending + 1, should_stop); }

void EvaluationPlanner::OnIteration(int64_t steps_before, int64_t env_steps,
                                    const std::shared_ptr<const PolicyWeights>& weights,
                                    const std::function<bool()>& should_stop) {
  const int64_t every = config_.every_steps();
  const bool due = every > 0 && config_.episodes() > 0 && env_steps / every > steps_before / every;
  // Before the wait, so that a checkpoint written during it has this evaluation.
  if (due) Begin(env_steps, config_.episodes(), /*final=*/false, weights);
  LogFinished(due ? kMaxPending + 1 : kAnyNumber, should_stop);
}

void EvaluationPlanner::OnEnd(int64_t env_steps, const std::shared_ptr<const PolicyWeights>& weights,
                              const std::function<bool()>& should_stop) {
  if (config_.final_episodes() > 0 && final_evaluation_steps_ != env_steps) {
    Begin(env_steps, config_.final_episodes(), /*final=*/true, weights);
    final_evaluation_steps_ = env_steps;
  }
  if (pending() == 0) return;
  LogInfo("training is over; waiting for the remaining evaluations (%d)", pending());
  LogFinished(1, should_stop);
}

void EvaluationPlanner::Begin(int64_t env_steps, int episodes, bool final,
                              const std::shared_ptr<const PolicyWeights>& weights) {
  const int64_t count = int64_t{2} * episodes;
  // After the last episode that an actor can play, they begin again.
  const int64_t first = next_episode_ > kLastEvaluationEpisode - count ? 1 : next_episode_;
  registry_->evaluations()->Add({++begun_, env_steps, first, episodes, final, weights});
  if (!final) next_episode_ = first + count;
}

void EvaluationPlanner::LogFinished(size_t below, const std::function<bool()>& should_stop) {
  while (LogOldest(absl::ZeroDuration())) {
  }
  absl::Time last_news = SteadyNow();
  while (pending() >= below && !should_stop()) {  // which is called without the registry's lock
    if (LogOldest(kTick)) {
      last_news = SteadyNow();
    } else if (SteadyNow() - last_news > kReportEvery) {
      last_news = SteadyNow();
      const std::string played = registry_->WaitsFor();
      LogInfo("waiting for actors to play the pending evaluations (%d)%s%s", pending(),
              played.empty() ? "" : "; being played: ", played);
    }
  }
}

bool EvaluationPlanner::LogOldest(absl::Duration timeout) {
  const std::optional<FinishedEvaluation> finished = registry_->FrontEvaluation(timeout);
  if (!finished.has_value()) return false;
  const Evaluation& evaluation = finished->evaluation;
  folder_->AddEvaluation(evaluation.final, finished->argmax, finished->sampled);
  registry_->evaluations()->Pop();
  const ScoreBoard& argmax = folder_->score(evaluation.final ? EpisodeKind::kFinalArgmax : EpisodeKind::kArgmax);
  const ScoreBoard& sampled = folder_->score(evaluation.final ? EpisodeKind::kFinalSampled : EpisodeKind::kSampled);
  const std::string group = evaluation.final ? "final/" : "eval/";
  const std::vector<Scalar> scalars = {{group + "argmax_score", argmax.Score()},
                                       {group + "argmax_reward", argmax.RecentReward()},
                                       {group + "sampled_score", sampled.Score()},
                                       {group + "sampled_reward", sampled.RecentReward()}};
  folder_->AddScalars(evaluation.env_steps, scalars);
  folder_->FlushLogs().IgnoreError();  // unwritten lines are kept, and TrainingLog reports the error
  LogInfo("evaluation %d, after %d steps: score over %d argmax episodes %.2f, over %d sampled episodes %.2f",
          evaluation.number, evaluation.env_steps, argmax.episodes(), argmax.Score(), sampled.episodes(),
          sampled.Score());
  return true;
}

absl::Status EvaluationPlanner::FillCheckpoint(Checkpoint* checkpoint) const {
  v1::CheckpointState& state = checkpoint->state;
  state.set_evaluations(begun_);
  state.set_next_eval_episode(next_episode_);
  state.set_final_evaluation_steps(final_evaluation_steps_);
  for (const Evaluation& evaluation : registry_->evaluations()->Pending()) {
    v1::PendingEvaluation* pending = state.add_pending();
    pending->set_number(evaluation.number);
    pending->set_env_steps(evaluation.env_steps);
    pending->set_first_episode(evaluation.first_episode);
    pending->set_episodes(evaluation.episodes);
    pending->set_final(evaluation.final);
    CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint->evaluation_weights.emplace_back(), evaluation.weights->Bytes());
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
