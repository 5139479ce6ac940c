#include "envserver/canary.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <absl/strings/str_format.h>
#include <absl/types/span.h>

#include "common/base/crafter.h"
#include "common/base/fnv1a.h"
#include "common/base/seeds.h"
#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "envserver/game.h"
#include "envserver/render/renderer.h"

namespace craftfleet {
namespace {

struct Part {
  const char* env;
  int frame_size;  // pixels
  int64_t seed;
  int steps;
};
// Changing them changes every canary. It is night from about the 200th step on.
constexpr Part kParts[] = {
    {"crafter", 64, 20, 320},
    {"crafter:numbers=easy-x4", 72, 21, 100},
};

template <typename Number>
uint64_t AddNumber(uint64_t hash, Number number) {
  return Fnv1a(hash, {reinterpret_cast<const char*>(&number), sizeof(number)});
}

absl::StatusOr<uint64_t> AddPart(uint64_t hash, const Part& part, const Textures& textures) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(part.env));
  const RenderOptions picture{part.frame_size, part.frame_size};
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Renderer> renderer,
                              Renderer::Create(textures, WorldOptions::FromEnvName(name), picture));
  std::vector<uint8_t> frame(renderer->frame_bytes());
  const absl::string_view shown(reinterpret_cast<const char*>(frame.data()), frame.size());
  CRAFTFLEET_ASSIGN_OR_RETURN(Game game, Game::Create(renderer, part.seed, absl::MakeSpan(frame)));
  hash = Fnv1a(hash, shown);
  for (int step = 0; step < part.steps; ++step) {
    const auto action = static_cast<Action>(MixBits(static_cast<uint64_t>(part.seed << 32) + step) % kNumActions);
    const StepOutcome outcome = game.Step(action, absl::MakeSpan(frame));
    hash = AddNumber(AddNumber(Fnv1a(hash, shown), outcome.reward), outcome.end);
    if (outcome.end != StepEnd::kNone) game.Reset(absl::MakeSpan(frame));
  }
  return hash;
}

}  // namespace

absl::StatusOr<std::string> GameCanary(const Textures& textures) {
  uint64_t hash = kFnv1aBasis;
  for (const Part& part : kParts) {
    CRAFTFLEET_ASSIGN_OR_RETURN(hash, AddPart(hash, part, textures));
  }
  return absl::StrFormat("%016x", hash);
}

}  // namespace craftfleet
