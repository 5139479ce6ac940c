#include "envserver/world/player.h"

#include <algorithm>
#include <array>

#include "envserver/world/appearance.h"
#include "envserver/world/creatures.h"
#include "envserver/world/rules.h"

namespace craftfleet {
namespace {

struct Amount {
  Item item = Item::kHealth;
  int count = 0;  // 0: nothing needed
};

struct CollectRule {
  Material material;
  Material leaves;
  Amount needs;
  Item gives;
  Achievement achievement;
  double probability;
};
constexpr CollectRule kCollectRules[] = {
    {Material::kTree, Material::kGrass, {}, Item::kWood, Achievement::kCollectWood, 1},
    {Material::kStone, Material::kPath, {Item::kWoodPickaxe, 1}, Item::kStone, Achievement::kCollectStone, 1},
    {Material::kCoal, Material::kPath, {Item::kWoodPickaxe, 1}, Item::kCoal, Achievement::kCollectCoal, 1},
    {Material::kIron, Material::kPath, {Item::kStonePickaxe, 1}, Item::kIron, Achievement::kCollectIron, 1},
    {Material::kDiamond, Material::kPath, {Item::kIronPickaxe, 1}, Item::kDiamond, Achievement::kCollectDiamond, 1},
    {Material::kWater, Material::kWater, {}, Item::kDrink, Achievement::kCollectDrink, 1},
    {Material::kGrass, Material::kGrass, {}, Item::kSapling, Achievement::kCollectSapling, 0.1},
};

struct PlaceRule {
  Action action;
  Amount uses;
  MaterialSet on;
  Material becomes;  // kNone: a Plant object is added
  Achievement achievement;
};
constexpr PlaceRule kPlaceRules[] = {
    {Action::kPlaceStone,
     {Item::kStone, 1},
     {Material::kGrass, Material::kSand, Material::kPath, Material::kWater, Material::kLava},
     Material::kStone,
     Achievement::kPlaceStone},
    {Action::kPlaceTable,
     {Item::kWood, 2},
     {Material::kGrass, Material::kSand, Material::kPath},
     Material::kTable,
     Achievement::kPlaceTable},
    {Action::kPlaceFurnace,
     {Item::kStone, 4},
     {Material::kGrass, Material::kSand, Material::kPath},
     Material::kFurnace,
     Achievement::kPlaceFurnace},
    {Action::kPlacePlant, {Item::kSapling, 1}, {Material::kGrass}, Material::kNone, Achievement::kPlacePlant},
};

struct MakeRule {
  Action action;
  std::array<Amount, 3> uses;
  bool needs_furnace;  // besides the table that all need
  Item makes;
  Achievement achievement;
};
constexpr std::array<Amount, 3> kWoodTool = {{{Item::kWood, 1}, {}, {}}};
constexpr std::array<Amount, 3> kStoneTool = {{{Item::kWood, 1}, {Item::kStone, 1}, {}}};
constexpr std::array<Amount, 3> kIronTool = {{{Item::kWood, 1}, {Item::kCoal, 1}, {Item::kIron, 1}}};
constexpr MakeRule kMakeRules[] = {
    {Action::kMakeWoodPickaxe, kWoodTool, false, Item::kWoodPickaxe, Achievement::kMakeWoodPickaxe},
    {Action::kMakeStonePickaxe, kStoneTool, false, Item::kStonePickaxe, Achievement::kMakeStonePickaxe},
    {Action::kMakeIronPickaxe, kIronTool, true, Item::kIronPickaxe, Achievement::kMakeIronPickaxe},
    {Action::kMakeWoodSword, kWoodTool, false, Item::kWoodSword, Achievement::kMakeWoodSword},
    {Action::kMakeStoneSword, kStoneTool, false, Item::kStoneSword, Achievement::kMakeStoneSword},
    {Action::kMakeIronSword, kIronTool, true, Item::kIronSword, Achievement::kMakeIronSword},
};

bool Has(const Player& player, Amount amount) { return player.item(amount.item) >= amount.count; }

void Count(Achievement achievement, Player* player) { ++player->achievements[static_cast<int>(achievement)]; }

void Move(Position direction, WorldState* state) {
  Board& board = state->board;
  board.object(0).facing = direction;
  TryMove(&board, 0, direction, kPlayerWalks);
  if (board.material(board.object(0).position) == Material::kLava) state->player.item(Item::kHealth) = 0;
}

int Damage(const Player& player) {
  if (player.item(Item::kIronSword) > 0) return 5;
  if (player.item(Item::kStoneSword) > 0) return 3;
  return player.item(Item::kWoodSword) > 0 ? 2 : 1;
}

// Returns whether the object's health is 0 now.
bool Hit(const Player& player, Object* object) {
  object->health = static_cast<int16_t>(std::max(0, object->health - Damage(player)));
  return object->health == 0;
}

void DoObject(Object* object, Player* player) {
  switch (object->type) {
    case ObjectType::kPlant:
      if (object->counter > kRipeAfter) {
        object->counter = 0;
        player->item(Item::kFood) += 4;
        Count(Achievement::kEatPlant, player);
      }
      break;
    case ObjectType::kZombie:
      if (Hit(*player, object)) Count(Achievement::kDefeatZombie, player);
      break;
    case ObjectType::kSkeleton:
      if (Hit(*player, object)) Count(Achievement::kDefeatSkeleton, player);
      break;
    case ObjectType::kCow:
      if (Hit(*player, object)) {
        player->item(Item::kFood) += 6;
        player->hunger = 0;
        Count(Achievement::kEatCow, player);
      }
      break;
    default:
      break;
  }
}

void Collect(Position target, WorldState* state) {
  Player& player = state->player;
  const Material material = state->board.material(target);
  if (material == Material::kWater) player.thirst = 0;
  for (const CollectRule& rule : kCollectRules) {
    if (rule.material != material) continue;
    if (!Has(player, rule.needs)) return;
    state->board.SetMaterial(target, rule.leaves, DrawVariant(state->options, rule.leaves, &state->random));
    if (state->random.Uniform() > rule.probability) return;
    ++player.item(rule.gives);
    Count(rule.achievement, &player);
    return;
  }
}

void Do(Position target, WorldState* state) {
  const int object = state->board.ObjectAt(target);
  if (object >= 0) {
    DoObject(&state->board.object(object), &state->player);
  } else {
    Collect(target, state);
  }
}

void Place(const PlaceRule& rule, Position target, WorldState* state) {
  Player& player = state->player;
  if (!IsFree(state->board, target, rule.on) || !Has(player, rule.uses)) return;
  player.item(rule.uses.item) -= rule.uses.count;
  if (rule.becomes == Material::kNone) {
    state->board.Add(MakeObject(ObjectType::kPlant, target));
  } else {
    state->board.SetMaterial(target, rule.becomes, DrawVariant(state->options, rule.becomes, &state->random));
  }
  Count(rule.achievement, &player);
}

// Whether `material` is in the 3x3 cells around `center`. At x = 0 and y = 0 the block is empty
// (RULES.md, section 6).
bool IsNear(const Board& board, Position center, Material material) {
  if (center.x == 0 || center.y == 0) return false;
  for (int x = center.x - 1; x <= center.x + 1; ++x) {
    for (int y = center.y - 1; y <= center.y + 1; ++y) {
      if (board.material({x, y}) == material) return true;
    }
  }
  return false;
}

void Make(const MakeRule& rule, WorldState* state) {
  Player& player = state->player;
  const Position position = state->board.object(0).position;
  if (!IsNear(state->board, position, Material::kTable)) return;
  if (rule.needs_furnace && !IsNear(state->board, position, Material::kFurnace)) return;
  for (const Amount amount : rule.uses) {
    if (!Has(player, amount)) return;
  }
  for (const Amount amount : rule.uses) player.item(amount.item) -= amount.count;
  ++player.item(rule.makes);
  Count(rule.achievement, &player);
}

void Act(Action action, WorldState* state) {
  Player& player = state->player;
  const Object& body = state->board.object(0);
  const Position target = body.position + body.facing;
  if (action >= Action::kMoveLeft && action <= Action::kMoveDown) {
    Move(kDirections[static_cast<int>(action) - static_cast<int>(Action::kMoveLeft)], state);
  } else if (action == Action::kDo) {
    Do(target, state);
  } else if (action == Action::kSleep) {
    if (player.item(Item::kEnergy) < kMaxItem) player.sleeping = true;
  } else if (action >= Action::kPlaceStone && action <= Action::kPlacePlant) {
    Place(kPlaceRules[static_cast<int>(action) - static_cast<int>(Action::kPlaceStone)], target, state);
  } else if (action >= Action::kMakeWoodPickaxe) {
    Make(kMakeRules[static_cast<int>(action) - static_cast<int>(Action::kMakeWoodPickaxe)], state);
  }
}

// Returns whether the counter exceeded the limit, and resets it then.
bool RunsOver(double limit, double* counter) {
  if (*counter <= limit) return false;
  *counter = 0;
  return true;
}

// The same below the limit.
bool RunsUnder(double limit, double* counter) {
  if (*counter >= limit) return false;
  *counter = 0;
  return true;
}

void FeelNeeds(Player* player) {
  const bool asleep = player->sleeping;
  player->hunger += asleep ? 0.5 : 1;
  if (RunsOver(25, &player->hunger)) --player->item(Item::kFood);
  player->thirst += asleep ? 0.5 : 1;
  if (RunsOver(20, &player->thirst)) --player->item(Item::kDrink);
  player->fatigue = asleep ? std::min(player->fatigue - 1, 0.0) : player->fatigue + 1;
  if (RunsUnder(-10, &player->fatigue)) ++player->item(Item::kEnergy);
  if (RunsOver(30, &player->fatigue)) --player->item(Item::kEnergy);
}

void Recover(Player* player) {
  const bool asleep = player->sleeping;
  const bool well =
      player->item(Item::kFood) > 0 && player->item(Item::kDrink) > 0 && (player->item(Item::kEnergy) > 0 || asleep);
  if (well) {
    player->recover += asleep ? 2 : 1;
  } else {
    player->recover -= asleep ? 0.5 : 1;
  }
  if (RunsOver(25, &player->recover)) ++player->item(Item::kHealth);
  if (RunsUnder(-15, &player->recover)) --player->item(Item::kHealth);
}

}  // namespace

void UpdatePlayer(Action action, WorldState* state) {
  Player& player = state->player;
  if (player.sleeping) {
    if (player.item(Item::kEnergy) < kMaxItem) {
      action = Action::kSleep;
    } else {
      player.sleeping = false;
      Count(Achievement::kWakeUp, &player);
    }
  }
  Act(action, state);
  FeelNeeds(&player);
  Recover(&player);
  for (int8_t& amount : player.inventory) amount = std::clamp<int8_t>(amount, 0, kMaxItem);
  if (player.health() < player.last_health) player.sleeping = false;
  player.last_health = player.health();
}

}  // namespace craftfleet
