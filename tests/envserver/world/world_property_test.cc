// Random games of random worlds: the invariants hold, and a restored game continues like the one it was saved
// from.

#include <random>
#include <string>

#include <gtest/gtest.h>

#include "envserver/world/world.h"
#include "tests/envserver/world/invariants.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

constexpr int kGames = 200;
constexpr int kSteps = 320;

WorldOptions RandomOptions(std::mt19937* random) {
  const auto below = [random](int n) { return static_cast<int>((*random)() % n); };
  constexpr const char* kNames[] = {"crafter",
                                    "crafter",
                                    "crafter:appearance=25/25/25/25",
                                    "crafter:numbers=mix",
                                    "crafter:appearance=0/33/33/34,numbers=hard-x4",
                                    "crafter:numbers=easy-x4"};
  WorldOptions options = WorldOptions::FromEnvName(*EnvName::Parse(kNames[below(6)]));
  if (below(3) == 0) {
    options.width = 4 + below(60);
    options.height = 4 + below(60);
    options.view_width = 3 + below(9);
    options.view_height = options.inventory_rows() + 1 + below(9);
  }
  if (below(4) == 0) options.length = 50 + below(200);
  if (below(6) == 0) {
    options.appearance = "pwi";
    options.percentages = {100, 0, 0, 0};
  }
  return options;
}

// Prefers actions that prolong a game: walking, hitting, sleeping.
Action RandomAction(std::mt19937* random) {
  const uint32_t draw = (*random)();
  if (draw % 3 == 0) return Action::kDo;
  return static_cast<Action>(draw / 3 % kNumActions);
}

std::string PlayOneGame(uint32_t seed) {
  std::mt19937 random(seed);
  const WorldOptions options = RandomOptions(&random);
  absl::StatusOr<World> world = World::Create(options, seed);
  absl::StatusOr<World> twin = World::Create(options, seed + 1);
  if (!world.ok() || !twin.ok()) return "cannot create the world";
  bool twin_follows = false;
  for (int step = 0; step < kSteps; ++step) {
    if (random() % 40 == 0) {
      const absl::Status restored = twin->Restore(world->Save(world->random()));
      if (!restored.ok()) return restored.ToString();
      twin_follows = true;
    }
    const Action action = RandomAction(&random);
    const StepOutcome outcome = world->Step(action);
    const std::string broken = BrokenInvariant(*world);
    if (!broken.empty()) return "step " + std::to_string(step) + ": " + broken;
    if (twin_follows) {
      const StepOutcome twins = twin->Step(action);
      if (twins.reward != outcome.reward || twins.end != outcome.end || twins.unlocked != outcome.unlocked) {
        return "step " + std::to_string(step) + ": the restored game's outcome differs";
      }
      if (twin->Save(twin->random()) != world->Save(world->random())) {
        return "step " + std::to_string(step) + ": the restored game's state differs";
      }
    }
    if (outcome.end != StepEnd::kNone) {
      world->Reset();
      if (twin_follows) twin->Reset();
    }
  }
  return "";
}

TEST(WorldProperty, RandomGamesKeepInvariantsAndRestoredOnesContinueIdentically) {
  for (uint32_t seed = 0; seed < kGames; ++seed) ASSERT_EQ(PlayOneGame(seed), "") << "seed " << seed;
}

}  // namespace
}  // namespace craftfleet
