#include "envserver/world/creatures.h"

#include <algorithm>
#include <cstdlib>

#include "envserver/world/rules.h"

namespace craftfleet {
namespace {

Position PlayerPosition(const WorldState& state) { return state.board.object(0).position; }

int DistanceToPlayer(int index, const WorldState& state) {
  return Distance(state.board.object(index).position, PlayerPosition(state));
}

// A unit step towards the player along the axis of the longer distance or along the other one; (0, 0) if the distance
// on that axis is 0.
Position Toward(int index, bool long_axis, const WorldState& state) {
  const Position player = PlayerPosition(state);
  const Position self = state.board.object(index).position;
  const int dx = player.x - self.x;
  const int dy = player.y - self.y;
  const bool along_x = (std::abs(dx) > std::abs(dy)) == long_axis;
  if (along_x) return {(dx > 0) - (dx < 0), 0};
  return {0, (dy > 0) - (dy < 0)};
}

bool Walk(int index, Position direction, WorldState* state) {
  return TryMove(&state->board, index, direction, kCreatureWalks);
}

void WalkAtRandom(int index, WorldState* state) { Walk(index, kDirections[state->random.Below(4)], state); }

void RemoveIfDead(int index, Board* board) {
  if (board->object(index).health <= 0) board->Remove(index);
}

void UpdateCow(int index, WorldState* state) {
  RemoveIfDead(index, &state->board);
  if (state->random.Uniform() < 0.5) WalkAtRandom(index, state);
}

void UpdateZombie(int index, WorldState* state) {
  RemoveIfDead(index, &state->board);
  if (DistanceToPlayer(index, *state) <= 8 && state->random.Uniform() < 0.9) {
    const bool long_axis = state->random.Uniform() < 0.8;
    Walk(index, Toward(index, long_axis, *state), state);
  } else {
    WalkAtRandom(index, state);
  }
  if (DistanceToPlayer(index, *state) > 1) return;
  int& cooldown = state->board.object(index).counter;
  if (cooldown > 0) {
    --cooldown;
    return;
  }
  Player& player = state->player;
  const int damage = player.sleeping ? 7 : 2;
  player.item(Item::kHealth) = static_cast<int8_t>(std::max(0, player.health() - damage));
  cooldown = 5;
}

void Shoot(int index, Position direction, WorldState* state) {
  Object& skeleton = state->board.object(index);
  const Position target = skeleton.position + direction;
  if (skeleton.counter > 0 || direction == Position() || !IsFree(state->board, target, kArrowFlies)) return;
  skeleton.counter = 4;
  Object arrow = MakeObject(ObjectType::kArrow, target);
  arrow.facing = direction;
  state->board.Add(arrow);
}

void UpdateSkeleton(int index, WorldState* state) {
  RemoveIfDead(index, &state->board);
  int& reload = state->board.object(index).counter;
  reload = std::max(0, reload - 1);
  const int distance = DistanceToPlayer(index, *state);
  RandomStream& random = state->random;
  if (distance <= 3) {
    const Position toward = Toward(index, random.Uniform() < 0.6, *state);
    if (Walk(index, {-toward.x, -toward.y}, state)) return;
  }
  if (distance <= 5 && random.Uniform() < 0.5) {
    Shoot(index, Toward(index, /*long_axis=*/true, *state), state);
  } else if (distance <= 8 && random.Uniform() < 0.3) {
    const bool long_axis = random.Uniform() < 0.6;
    Walk(index, Toward(index, long_axis, *state), state);
  } else if (random.Uniform() < 0.2) {
    WalkAtRandom(index, state);
  }
}

void UpdateArrow(int index, WorldState* state) {
  Board& board = state->board;
  const Object arrow = board.object(index);
  const Position target = arrow.position + arrow.facing;
  const int hit = board.ObjectAt(target);
  if (hit == 0) {
    Player& player = state->player;
    player.item(Item::kHealth) = static_cast<int8_t>(std::max(0, player.health() - 2));
  } else if (hit > 0) {
    Object& object = board.object(hit);
    object.health = static_cast<int16_t>(std::max(0, object.health - 2));
  }
  if (hit < 0 && IsFree(board, target, kArrowFlies)) {
    board.Move(index, target);
    return;
  }
  board.Remove(index);
  const Material material = board.material(target);
  if (hit < 0 && (material == Material::kTable || material == Material::kFurnace)) {
    board.SetMaterial(target, Material::kPath, kNoVariant);
  }
}

void UpdatePlant(int index, WorldState* state) {
  Board& board = state->board;
  Object& plant = board.object(index);
  ++plant.counter;
  const bool eaten = std::any_of(std::begin(kDirections), std::end(kDirections), [&](Position direction) {
    const int neighbour = board.ObjectAt(plant.position + direction);
    if (neighbour < 0) return false;
    const ObjectType type = board.object(neighbour).type;
    return type == ObjectType::kZombie || type == ObjectType::kSkeleton || type == ObjectType::kCow;
  });
  if (eaten) plant.health = static_cast<int16_t>(std::max(0, plant.health - 1));
  RemoveIfDead(index, &board);
}

int HealthOf(ObjectType type) {
  switch (type) {
    case ObjectType::kCow:
    case ObjectType::kSkeleton:
      return 3;
    case ObjectType::kZombie:
      return 5;
    case ObjectType::kPlant:
      return 1;
    default:
      return 0;
  }
}

}  // namespace

Object MakeObject(ObjectType type, Position position) {
  Object object;
  object.type = type;
  object.health = static_cast<int16_t>(HealthOf(type));
  object.position = position;
  return object;
}

void AddCreature(ObjectType type, Position position, Variant variant, Board* board) {
  Object creature = MakeObject(type, position);
  creature.variant = variant;
  board->Add(creature);
}

void UpdateObject(int index, WorldState* state) {
  switch (state->board.object(index).type) {
    case ObjectType::kCow:
      return UpdateCow(index, state);
    case ObjectType::kZombie:
      return UpdateZombie(index, state);
    case ObjectType::kSkeleton:
      return UpdateSkeleton(index, state);
    case ObjectType::kArrow:
      return UpdateArrow(index, state);
    case ObjectType::kPlant:
      return UpdatePlant(index, state);
    default:
      return;
  }
}

}  // namespace craftfleet
