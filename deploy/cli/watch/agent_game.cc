#include "deploy/cli/watch/agent_game.h"

#include <utility>

#include <absl/memory/memory.h>

#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

absl::Span<uint8_t> Bytes(std::string* text) {
  return absl::MakeSpan(reinterpret_cast<uint8_t*>(text->data()), text->size());
}

}  // namespace

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
  CRAFTFLEET_ASSIGN_OR_RETURN(Game game, Game::Create(renderer_, options_.seed, Bytes(&frame_), episode));
  game_.emplace(std::move(game));
  state_.assign(policy_->state_size(), 0);
  outcome_ = StepOutcome();
  events_.Clear();
  return Decide();
}

absl::Status AgentGame::Step() {
  if (ended()) return absl::OkStatus();
  outcome_ = game_->Step(decision_->action, Bytes(&frame_));
  events_.Add(world(), outcome_);
  return ended() ? absl::OkStatus() : Decide();
}

absl::Status AgentGame::Decide() {
  // Like the evaluator, so that episodes are the same: lane and noise are those of the episode's number.
  const int lane = static_cast<int>(world().episode());
  const double noise = ActionNoise(static_cast<uint64_t>(options_.seed), lane, world().step());
  CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult act, options_.greedy
                                                       ? policy_->ActGreedily(frame_, {lane}, absl::MakeSpan(state_))
                                                       : policy_->Act(frame_, {lane}, {noise}, absl::MakeSpan(state_)));
  decision_ = Decision{act.actions[0], act.odds[0], act.values[0]};
  return absl::OkStatus();
}

absl::StatusOr<std::string> AgentGame::Picture(int size) {
  CRAFTFLEET_ASSIGN_OR_RETURN(Moment moment, pictures_.Take(*game_, frame_, size));
  return std::move(moment.picture);
}

}  // namespace craftfleet
