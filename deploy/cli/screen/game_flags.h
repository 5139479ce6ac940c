// The flags that the programs with a game on a screen share, checked and turned into what they name.

#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/agent/attention_map.h"
#include "common/config/env_name.h"
#include "deploy/cli/screen/screen.h"
#include "envserver/render/textures.h"

namespace craftfleet {

// All return errors that name the flag.

// --env.
absl::StatusOr<EnvName> EnvFromFlag(const std::string& name);

// --textures: a folder; empty: the textures that are built in.
absl::StatusOr<std::shared_ptr<const Textures>> TexturesFromFlag(const std::string& folder);

// --attention: off is nothing.
absl::StatusOr<std::optional<AttentionChoice>> AttentionFromFlag();

// --episode: 1..1,000,000,000, and --size: 64..1024 pixels.
absl::Status CheckEpisodeAndSize(int64_t episode, int size);

// Whether there is the screen that --terminal chooses. To be called before other threads start.
//   FailedPrecondition: there is no display, or the terminal can't be used.
absl::Status CheckScreen(bool terminal);

// --terminal: the terminal, otherwise a window with this title and room for pictures of `size` pixels.
//   FailedPrecondition: the terminal can't be used.   Internal: the window can't be opened.
absl::StatusOr<std::unique_ptr<Screen>> OpenScreen(bool terminal, const std::string& title, int size);

}  // namespace craftfleet
