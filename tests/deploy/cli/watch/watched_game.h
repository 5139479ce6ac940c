// Games of a sample policy.

#ifndef CRAFTFLEET_TESTS_DEPLOY_CLI_WATCH_WATCHED_GAME_H_
#define CRAFTFLEET_TESTS_DEPLOY_CLI_WATCH_WATCHED_GAME_H_

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

#endif  // CRAFTFLEET_TESTS_DEPLOY_CLI_WATCH_WATCHED_GAME_H_
