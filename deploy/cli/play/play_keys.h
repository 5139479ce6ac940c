// The keys of `craftfleet play`: those of Crafter's own window, and more.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLAY_PLAY_KEYS_H_
#define CRAFTFLEET_DEPLOY_CLI_PLAY_PLAY_KEYS_H_

#include <optional>
#include <vector>

#include "common/base/crafter.h"
#include "deploy/cli/screen/keys.h"
#include "deploy/cli/screen/text_line.h"

namespace craftfleet {

// The action of a key; nullopt if it has none.
std::optional<Action> ActionOfKey(Key key);

// The help page: every key with its effect.
std::vector<TextLine> KeyHelp();

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLAY_PLAY_KEYS_H_
