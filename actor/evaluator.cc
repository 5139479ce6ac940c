#include "actor/evaluator.h"

#include <algorithm>
#include <map>
#include <string>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/base/crafter.h"
#include "common/base/keyed_random.h"
#include "common/base/seeds.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// One evaluation. Episode number e plays on lane e, so that its tile row, action noise and game depend only on e.
class Evaluation {
 public:
  Evaluation(const EvaluationOptions& options, const Policy& policy, EnvClient* env, EpisodeObserver* observer,
             const std::atomic<bool>* stop)
      : options_(options), policy_(policy), env_(env), observer_(observer), stop_(stop) {}

  absl::StatusOr<std::vector<Episode>> Run(const std::function<void(int)>& on_step) {
    const int64_t end = options_.first_episode + options_.episodes;
    int64_t next = options_.first_episode;
    while (!Stopped() && (next < end || !playing_.empty())) {
      while (next < end && static_cast<int>(playing_.size()) < options_.lanes) CRAFTFLEET_RETURN_IF_ERROR(Open(next++));
      CRAFTFLEET_RETURN_IF_ERROR(Step());
      on_step(static_cast<int>(finished_.size()));
    }
    std::vector<Episode> episodes;
    for (auto& [number, episode] : finished_) episodes.push_back(episode);
    return episodes;
  }

 private:
  struct Playing {
    int64_t step = 0;
    std::string frame;
    std::vector<float> state;  // recurrent or memory, zero at the episode's start
  };

  bool Stopped() const { return stop_ != nullptr && *stop_; }

  absl::Status Open(int64_t episode) {
    Playing& game = playing_[static_cast<int>(episode)];
    game.state.resize(policy_.state_size());
    CRAFTFLEET_RETURN_IF_ERROR(env_->Open({{static_cast<int>(episode), options_.seed, episode, ""}}, &game.frame));
    return observer_ == nullptr ? absl::OkStatus() : observer_->OnStart(episode, env_->moments()[0]);
  }

  absl::Status Step() {
    std::vector<int> lanes;
    std::vector<double> noise;
    std::string frames;
    std::vector<float> states;
    for (const auto& [lane, game] : playing_) {
      lanes.push_back(lane);
      if (!options_.greedy) noise.push_back(ActionNoise(static_cast<uint64_t>(options_.seed), lane, game.step));
      frames.append(game.frame);
      states.insert(states.end(), game.state.begin(), game.state.end());
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult act, policy_.Act(frames, lanes, noise, absl::MakeSpan(states)));
    const float* state = states.data();
    for (auto& [lane, game] : playing_) {
      std::copy_n(state, game.state.size(), game.state.begin());
      state += game.state.size();
    }
    CRAFTFLEET_RETURN_IF_ERROR(env_->SendStep(lanes, act.actions, /*snapshot=*/false));
    CRAFTFLEET_RETURN_IF_ERROR(env_->ReceiveStep(&batch_));
    if (observer_ != nullptr) CRAFTFLEET_RETURN_IF_ERROR(Show(lanes, act.actions));
    return HandleStep(lanes);
  }

  absl::Status Show(const std::vector<int>& lanes, const std::vector<Action>& actions) {
    for (size_t row = 0; row < lanes.size(); ++row) {
      const ObservedStep step = {actions[row], batch_.rewards[row], batch_.ends[row]};
      CRAFTFLEET_RETURN_IF_ERROR(observer_->OnStep(lanes[row], step, env_->moments()[row]));
    }
    return absl::OkStatus();
  }

  absl::Status HandleStep(const std::vector<int>& lanes) {
    const size_t frame_bytes = batch_.frames.size() / lanes.size();
    if (policy_.has_memory()) CRAFTFLEET_RETURN_IF_ERROR(UpdateMemories(lanes, frame_bytes));
    std::vector<int> done;
    for (size_t row = 0; row < lanes.size(); ++row) {
      Playing& game = playing_[lanes[row]];
      ++game.step;
      game.frame.assign(batch_.frames, row * frame_bytes, frame_bytes);
      if (batch_.ends[row] == StepEnd::kNone) continue;
      finished_[lanes[row]] = batch_.episodes[done.size()];
      done.push_back(lanes[row]);
    }
    for (const int lane : done) playing_.erase(lane);
    return done.empty() ? absl::OkStatus() : env_->Close(done);
  }

  // Of the games that unlocked an achievement in this step and play on.
  absl::Status UpdateMemories(const std::vector<int>& lanes, size_t frame_bytes) {
    std::vector<int> unlocked;
    std::string before;
    std::string after;
    for (size_t row = 0; row < lanes.size(); ++row) {
      if (batch_.ends[row] != StepEnd::kNone || !UnlocksAchievement(batch_.rewards[row])) continue;
      unlocked.push_back(lanes[row]);
      before += playing_[lanes[row]].frame;
      after.append(batch_.frames, row * frame_bytes, frame_bytes);
    }
    if (unlocked.empty()) return absl::OkStatus();
    const auto size = static_cast<size_t>(policy_.state_size());
    std::vector<float> memories(unlocked.size() * size);
    CRAFTFLEET_RETURN_IF_ERROR(policy_.Remember(before, after, unlocked, absl::MakeSpan(memories)));
    for (size_t i = 0; i < unlocked.size(); ++i) {
      std::copy_n(memories.begin() + i * size, size, playing_[unlocked[i]].state.begin());
    }
    return absl::OkStatus();
  }

  const EvaluationOptions options_;
  const Policy& policy_;
  EnvClient* const env_;
  EpisodeObserver* const observer_;      // may be null
  const std::atomic<bool>* const stop_;  // may be null
  std::map<int, Playing> playing_;       // by episode number
  std::map<int, Episode> finished_;      // by episode number
  StepBatch batch_;
};

}  // namespace

absl::Status EvaluationOptions::Validate() const {
  if (episodes < 1 || episodes > kMaxEvaluationEpisodes || first_episode < 1 ||
      first_episode > kLastEvaluationEpisode - (episodes - 1)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--episodes=%d, starting with episode %d, want 1..%d and none beyond episode %d", episodes,
                        first_episode, kMaxEvaluationEpisodes, kLastEvaluationEpisode));
  }
  if (lanes < 1 || lanes > 256) return absl::InvalidArgumentError(absl::StrFormat("--lanes=%d, want 1..256", lanes));
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Episode>> Evaluate(const EvaluationOptions& options, const Policy& policy, EnvClient* env,
                                              const std::function<void(int)>& on_step, EpisodeObserver* observer,
                                              const std::atomic<bool>* stop) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  return Evaluation(options, policy, env, observer, stop).Run(on_step);
}

}  // namespace craftfleet
