// A game that a policy plays step by step, to be watched.

#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/agent/attention_map.h"
#include "common/agent/categorical.h"
#include "common/agent/policy.h"
#include "common/base/types.h"
#include "common/config/env_name.h"
#include "deploy/cli/screen/game_pictures.h"
#include "deploy/cli/screen/game_text.h"
#include "envserver/game.h"
#include "envserver/render/textures.h"

namespace craftfleet {

// Episode n of environment and seed is the one that `craftfleet eval` plays with the same weights. Thread-compatible.
class AgentGame {
 public:
  struct Options {
    EnvName env;
    int length = kEpisodeLength;  // steps after which an episode is truncated; 0: Crafter's 10,000
    int frame_size = 64;          // pixels, of the policy's frames
    int64_t seed = 0;             // of the environment
    bool greedy = false;          // play the most probable action instead of a sampled one
    std::shared_ptr<const Textures> textures;
  };
  // What the policy makes of the current frame.
  struct Decision {
    Action action = Action::kNoop;
    Categorical odds;
    float value = 0;
  };

  // At the beginning of `episode`, 1..2^31-1.   Errors as Renderer::Create, World::Create and Policy::Act.
  static absl::StatusOr<std::unique_ptr<AgentGame>> Create(const Options& options, std::shared_ptr<const Policy> policy,
                                                           int64_t episode);

  // Begins an episode with `policy`, which takes frames of the same size as the previous one.
  absl::Status Start(std::shared_ptr<const Policy> policy, int64_t episode);
  // Plays the decided action. Does nothing once the episode has ended.
  absl::Status Step();

  bool ended() const { return outcome_.end != StepEnd::kNone; }
  const World& world() const { return game_->world(); }
  // The outcome of the last step.
  const StepOutcome& outcome() const { return outcome_; }
  // The next action; that of the last step once the episode has ended.
  const Decision& decision() const { return *decision_; }
  const RecentEvents& events() const { return events_; }

  // uint8[size,size,3].
  absl::StatusOr<std::string> Picture(int size);
  // The policy's attention to the current frame.   InvalidArgument: it has none.
  absl::StatusOr<AttentionMap> Attention() const { return policy_->Attention(frame_); }
  int frame_size() const { return options_.frame_size; }

 private:
  AgentGame(const Options& options, std::shared_ptr<const Renderer> renderer)
      : options_(options), renderer_(std::move(renderer)), pictures_(options.textures, options.env) {}

  absl::Status Decide();
  // As in the evaluator, so that episodes are the same: the episode's number.
  int lane() const { return static_cast<int>(world().episode()); }

  const Options options_;
  const std::shared_ptr<const Renderer> renderer_;
  GamePictures pictures_;
  std::shared_ptr<const Policy> policy_;
  std::optional<Game> game_;
  std::string frame_;         // uint8[frame_size,frame_size,3]
  std::vector<float> state_;  // of the policy
  StepOutcome outcome_;
  std::optional<Decision> decision_;
  RecentEvents events_{1};
};

}  // namespace craftfleet
