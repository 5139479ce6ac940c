#include "deploy/cli/watch/agent_game.h"

#include <utility>

#include <absl/memory/memory.h>

#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"

namespace craftfleet {
absl::StatusOr<std::unique_ptr<AgentGame>> AgentGame::Create(const Options& options,
                                                             std::shared_ptr<const Policy> policy, int64_t episode) {
  const int length = options.length == 0 ? kEpisodeLength : options.length;
  CRAFTFLEET_ASSIGN_OR_RETURN(auto renderer,
                              SquareRenderer(*options.textures, options.env, length, options.frame_size));
  auto game = absl::WrapUnique(new AgentGame(options, std::move(renderer)));
  CRAFTFLEET_RETURN_IF_ERROR(game->Start(std::move(policy), episode));
  return game;
}

absl::Status AgentGame::Start(std::shared_ptr<const Policy> policy, int64_t episode) {
  policy_ = std::move(policy);
  frame_.assign(renderer_->frame_bytes(), '\0');
  CRAFTFLEET_ASSIGN_OR_RETURN(Game game, Game::Create(renderer_, options_.seed, FrameBytes(&frame_), episode));
  game_.emplace(std::move(game));
  state_.assign(policy_->state_size(), 0);
  outcome_ = StepOutcome();
  events_.Clear();
  return Decide();
}

absl::Status AgentGame::Step() {
  if (ended()) return absl::OkStatus();
  const std::string before = frame_;
  outcome_ = game_->Step(decision_->action, FrameBytes(&frame_));
  events_.Add(world(), outcome_);
  if (ended()) return absl::OkStatus();
  if (policy_->has_memory() && UnlocksAchievement(static_cast<float>(outcome_.reward))) {
    CRAFTFLEET_RETURN_IF_ERROR(policy_->Remember(before, frame_, {lane()}, absl::MakeSpan(state_)));
  }
  return Decide();
}

absl::Status AgentGame::Decide() {
  std::vector<double> noise;
  if (!options_.greedy) noise = {ActionNoise(static_cast<uint64_t>(options_.seed), lane(), world().step())};
  CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult act, policy_->Act(frame_, {lane()}, noise, absl::MakeSpan(state_)));
  decision_ = Decision{act.actions[0], act.odds[0], act.values[0]};
  return absl::OkStatus();
}

absl::StatusOr<std::string> AgentGame::Picture(int size) {
  CRAFTFLEET_ASSIGN_OR_RETURN(Moment moment, pictures_.Take(*game_, frame_, size));
  return std::move(moment.picture);
}

}  // namespace craftfleet
