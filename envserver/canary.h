// A canary: tells whether two environment servers play the same game.

#ifndef CRAFTFLEET_ENVSERVER_CANARY_H_
#define CRAFTFLEET_ENVSERVER_CANARY_H_

#include <string>

#include <absl/status/statusor.h>

#include "envserver/render/textures.h"

namespace craftfleet {

// 16 hexadecimal digits: a digest of all that some hundred fixed steps of fixed games show and give, by day and by
// night. Servers with the same textures whose canaries differ have other rules or other pictures. Takes some tens of
// milliseconds. Fails as World::Create and Renderer::Create.
absl::StatusOr<std::string> GameCanary(const Textures& textures);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_CANARY_H_
