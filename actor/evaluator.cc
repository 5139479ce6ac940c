#include "actor/evaluator.h"

#include <algorithm>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/keyed_random.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

constexpr int kMaxEpisodes = 10000;                                // at once: they are kept until the end
constexpr int64_t kLastEpisode = std::numeric_limits<int>::max();  // an episode's number is its lane's

// One evaluation: episode number e plays on lane e, so that its tile row, its action noise and its game depend on e
// alone.
class Evaluation {
 public:
  Evaluation(const EvaluationOptions& options, const Policy& policy, EnvClient* env, EpisodeObserver* observer)
      : options_(options), policy_(policy), env_(env), observer_(observer) {}

  absl::StatusOr<std::vector<Episode>> Run(const std::function<void(int)>& on_episode) {
    const int64_t end = options_.first_episode + options_.episodes;
    int64_t next = options_.first_episode;
    while (next < end || !playing_.empty()) {
      while (next < end && static_cast<int>(playing_.size()) < options_.lanes) CRAFTFLEET_RETURN_IF_ERROR(Open(next++));
      CRAFTFLEET_RETURN_IF_ERROR(Step());
      on_episode(static_cast<int>(finished_.size()));
    }
    std::vector<Episode> episodes;
    for (auto& [number, episode] : finished_) episodes.push_back(episode);
    return episodes;
  }

 private:
  struct Playing {
    int64_t step = 0;
    std::string frame;
    std::vector<float> state;  // recurrent, zero at the episode's start
  };

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
      noise.push_back(ActionNoise(static_cast<uint64_t>(options_.seed), lane, game.step));
      frames.append(game.frame);
      states.insert(states.end(), game.state.begin(), game.state.end());
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult act, options_.greedy
                                                         ? policy_.ActGreedily(frames, lanes, absl::MakeSpan(states))
                                                         : policy_.Act(frames, lanes, noise, absl::MakeSpan(states)));
    const float* state = states.data();
    for (auto& [lane, game] : playing_) {
      std::copy_n(state, game.state.size(), game.state.begin());
      state += game.state.size();
    }
    CRAFTFLEET_RETURN_IF_ERROR(env_->SendStep(lanes, act.actions, /*snapshot=*/false));
    CRAFTFLEET_RETURN_IF_ERROR(env_->ReceiveStep(&batch_));
    if (observer_ != nullptr) CRAFTFLEET_RETURN_IF_ERROR(Show(lanes, act.actions));
    return TakeIn(lanes);
  }

  absl::Status Show(const std::vector<int>& lanes, const std::vector<Action>& actions) {
    for (size_t row = 0; row < lanes.size(); ++row) {
      const ObservedStep step = {actions[row], batch_.rewards[row], batch_.ends[row]};
      CRAFTFLEET_RETURN_IF_ERROR(observer_->OnStep(lanes[row], step, env_->moments()[row]));
    }
    return absl::OkStatus();
  }

  absl::Status TakeIn(const std::vector<int>& lanes) {
    const size_t frame_bytes = batch_.frames.size() / lanes.size();
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

  const EvaluationOptions options_;
  const Policy& policy_;
  EnvClient* const env_;
  EpisodeObserver* const observer_;  // may be null
  std::map<int, Playing> playing_;   // by episode number
  std::map<int, Episode> finished_;  // by episode number
  StepBatch batch_;
};

}  // namespace

absl::Status EvaluationOptions::Validate() const {
  if (episodes < 1 || episodes > kMaxEpisodes || first_episode < 1 || first_episode > kLastEpisode - (episodes - 1)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--episodes=%d from episode %d on, want 1..%d and none beyond episode %d", episodes,
                        first_episode, kMaxEpisodes, kLastEpisode));
  }
  if (lanes < 1 || lanes > 256) return absl::InvalidArgumentError(absl::StrFormat("--lanes=%d, want 1..256", lanes));
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Episode>> Evaluate(const EvaluationOptions& options, const Policy& policy, EnvClient* env,
                                              const std::function<void(int)>& on_episode, EpisodeObserver* observer) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  return Evaluation(options, policy, env, observer).Run(on_episode);
}

}  // namespace craftfleet
