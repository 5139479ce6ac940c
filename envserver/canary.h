// A canary: a digest that differs between environment servers whose games differ.

#pragma once

#include <string>

#include <absl/status/statusor.h>

#include "envserver/render/textures.h"

namespace craftfleet {

// 16 hexadecimal digits: a digest of the observations and results of some hundred fixed steps of fixed games, by day
// and by night. Servers with the same textures but different canaries differ in rules or rendering. Takes some tens of
// milliseconds. Fails as World::Create and Renderer::Create.
absl::StatusOr<std::string> GameCanary(const Textures& textures);

}  // namespace craftfleet
