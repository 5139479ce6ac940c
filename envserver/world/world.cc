#include "envserver/world/world.h"

#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "envserver/world/appearance.h"
#include "envserver/world/balance.h"
#include "envserver/world/creatures.h"
#include "envserver/world/daylight.h"
#include "envserver/world/episode_seed.h"
#include "envserver/world/generation.h"
#include "envserver/world/player.h"
#include "envserver/world/rules.h"
#include "envserver/world/snapshot.h"

namespace craftfleet {
namespace {

constexpr int kBalanceEvery = 10;  // steps

Player NewPlayer() {
  Player player;
  for (const Item item : {Item::kHealth, Item::kFood, Item::kDrink, Item::kEnergy}) player.item(item) = kMaxItem;
  return player;
}

void UpdateObjects(Action action, WorldState* state) {
  Board& board = state->board;
  // Objects added during the loop wait for the next step.
  const int count = static_cast<int>(board.objects().size());
  UpdatePlayer(action, state);
  const Position player = board.object(0).position;
  const int reach = state->options.update_distance();
  for (int i = 1; i < count; ++i) {
    if (Distance(board.object(i).position, player) < reach) UpdateObject(i, state);
  }
}

// Bit a: achievement a was unlocked in this episode.
uint32_t Unlocked(const Player& player) {
  uint32_t bits = 0;
  for (int i = 0; i < kNumAchievements; ++i) bits |= static_cast<uint32_t>(player.achievements[i] > 0) << i;
  return bits;
}

}  // namespace

absl::StatusOr<World> World::Create(const WorldOptions& options, int64_t seed, int64_t episode) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  World world(options);
  world.state_.seed = seed;
  // An episode depends on seed and number alone.
  world.state_.episode = episode - 1;
  world.Reset();
  return world;
}

void World::Reset() {
  WorldState& state = state_;
  ++state.episode;
  state.random = RandomStream(EpisodeSeed(state.seed, state.episode));
  state.step = 0;
  state.daylight = Daylight(0);
  state.episode_reward = 0;
  state.player = NewPlayer();
  state.last_health = state.player.health();
  state.board.Clear();
  Object body = MakeObject(ObjectType::kPlayer, {state.board.width() / 2, state.board.height() / 2});
  body.facing = {0, 1};
  body.variant = DrawVariant(state.options, ObjectType::kPlayer, &state.random);
  state.board.Add(body);
  GenerateWorld(&state);
}

StepOutcome World::Step(Action action) {
  WorldState& state = state_;
  ++state.step;
  state.daylight = Daylight(state.step);
  const uint32_t unlocked_before = Unlocked(state.player);
  UpdateObjects(action, &state);
  if (state.step % kBalanceEvery == 0) BalanceChunks(&state);
  state.board.Compact();

  StepOutcome outcome;
  outcome.unlocked = Unlocked(state.player) & ~unlocked_before;
  const int health = state.player.health();
  outcome.reward = (health - state.last_health) / 10.0;
  if (outcome.unlocked != 0) outcome.reward += 1.0;
  state.last_health = health;
  state.episode_reward += outcome.reward;
  outcome.end = end();
  return outcome;
}

StepEnd World::end() const {
  if (player().health() <= 0) return StepEnd::kTerminated;
  return options().length > 0 && step() >= options().length ? StepEnd::kTruncated : StepEnd::kNone;
}

void World::SemanticView(absl::Span<uint8_t> out) const {
  const Board& board = state_.board;
  CRAFTFLEET_CHECK(out.size() == static_cast<size_t>(board.width()) * board.height());
  size_t n = 0;
  for (const BoardCell& cell : board.cells()) out[n++] = static_cast<uint8_t>(cell.material);
  for (const Object& object : board.objects()) {
    const int id = kNumMaterials - 1 + static_cast<int>(object.type);
    out[object.position.x * board.height() + object.position.y] = static_cast<uint8_t>(id);
  }
}

std::string World::Save(const RandomStream& stream) const { return SaveState(state_, stream); }

absl::Status World::Restore(absl::string_view snapshot) { return RestoreState(snapshot, &state_); }

}  // namespace craftfleet
