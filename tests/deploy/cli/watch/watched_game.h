// Games of a sample policy.

#pragma once

#include "deploy/cli/watch/agent_game.h"

namespace craftfleet {

inline AgentGame::Options WatchedOptions(int length = 40) {
  AgentGame::Options options;
  options.length = length;
  options.seed = 5;
  options.textures = Textures::BuiltIn();
  return options;
}

}  // namespace craftfleet
