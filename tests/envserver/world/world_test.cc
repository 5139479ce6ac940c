// The rules in small staged situations, through the public interface. The golden traces check every bit; these tests
// document the rules and need no data from outside the repository.

#include "envserver/world/world.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "tests/fakes/status_matchers.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using nlohmann::json;
using testing::HasSubstr;

constexpr uint32_t Bit(Achievement achievement) { return 1u << static_cast<int>(achievement); }

// A meadow without creatures, the player at (32, 32) facing down to (32, 33).
World Meadow(int length = 10000) {
  WorldOptions options;
  options.length = length;
  World world = *World::Create(options, 1);
  json edit;
  for (int x = 0; x < options.width; ++x) {
    for (int y = 0; y < options.height; ++y) edit["mat"].push_back({x, y, static_cast<int>(Material::kGrass)});
  }
  for (const Object& object : world.objects().subspan(1)) {
    edit["rm"].push_back({object.position.x, object.position.y});
  }
  EXPECT_THAT(WorldEditor::Apply(edit, &world), IsOk());
  return world;
}

void Stage(const std::string& edit, World* world) { ASSERT_THAT(WorldEditor::Apply(json::parse(edit), world), IsOk()); }

int ItemOf(const World& world, Item item) { return world.player().item(item); }

TEST(World, CreateRefusesBadOptions) {
  WorldOptions options;
  options.width = 0;
  EXPECT_THAT(World::Create(options, 1), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("width 0")));
}

TEST(World, FirstEpisodeStartsInTheMiddle) {
  const World world = *World::Create({}, 0);
  EXPECT_EQ(world.episode(), 1);
  EXPECT_EQ(world.step(), 0);
  EXPECT_EQ(world.player_position(), (Position{32, 32}));
  EXPECT_EQ(world.objects()[0].facing, (Position{0, 1}));
  EXPECT_EQ(world.material({32, 32}), Material::kGrass);
  EXPECT_EQ(world.material({-1, 0}), Material::kNone);
  EXPECT_EQ(world.material({0, 64}), Material::kNone);
  EXPECT_EQ(world.player().health(), 9);
}

TEST(World, ResetStartsTheNextEpisode) {
  World world = Meadow();
  Stage(R"({"inv": {"wood": 5, "health": 2}, "sleep": 1})", &world);
  world.Reset();
  EXPECT_EQ(world.episode(), 2);
  EXPECT_EQ(world.step(), 0);
  EXPECT_EQ(ItemOf(world, Item::kWood), 0);
  EXPECT_EQ(world.player().health(), 9);
  EXPECT_FALSE(world.player().sleeping);
  World other = *World::Create({}, 1);
  other.Reset();
  EXPECT_EQ(world.Save(world.random()), other.Save(other.random()));
}

TEST(World, FirstWoodIsRewardedOnce) {
  World world = Meadow();
  Stage(R"({"mat": [[32, 33, 6]]})", &world);  // tree
  StepOutcome outcome = world.Step(Action::kDo);
  EXPECT_EQ(outcome.reward, 1);
  EXPECT_EQ(outcome.unlocked, Bit(Achievement::kCollectWood));
  EXPECT_EQ(ItemOf(world, Item::kWood), 1);
  EXPECT_EQ(world.material({32, 33}), Material::kGrass);
  Stage(R"({"mat": [[32, 33, 6]]})", &world);
  outcome = world.Step(Action::kDo);
  EXPECT_EQ(outcome.reward, 0);
  EXPECT_EQ(outcome.unlocked, 0u);
  EXPECT_EQ(world.player().achievements[static_cast<int>(Achievement::kCollectWood)], 2);
  EXPECT_EQ(world.episode_reward(), 1);
}

TEST(World, LengthTruncatesAndDeathTerminates) {
  World world = Meadow(/*length=*/3);
  EXPECT_EQ(world.Step(Action::kNoop).end, StepEnd::kNone);
  EXPECT_EQ(world.Step(Action::kNoop).end, StepEnd::kNone);
  EXPECT_EQ(world.Step(Action::kNoop).end, StepEnd::kTruncated);
  world = Meadow(/*length=*/1);
  Stage(R"({"mat": [[31, 32, 7]]})", &world);  // lava
  const StepOutcome outcome = world.Step(Action::kMoveLeft);
  EXPECT_EQ(outcome.end, StepEnd::kTerminated);
  EXPECT_EQ(outcome.reward, -0.9);
}

TEST(World, WithoutALengthLimitEpisodesAreNotTruncated) {
  World world = Meadow(/*length=*/0);
  Stage(R"({"step": 1000000})", &world);
  EXPECT_EQ(world.Step(Action::kNoop).end, StepEnd::kNone);
}

TEST(World, MakingNeedsATableNearby) {
  World world = Meadow();
  Stage(R"({"inv": {"wood": 1}})", &world);
  EXPECT_EQ(world.Step(Action::kMakeWoodPickaxe).unlocked, 0u);
  Stage(R"({"mat": [[31, 31, 11]]})", &world);
  EXPECT_EQ(world.Step(Action::kMakeWoodPickaxe).unlocked, Bit(Achievement::kMakeWoodPickaxe));
  EXPECT_EQ(ItemOf(world, Item::kWood), 0);
  EXPECT_EQ(ItemOf(world, Item::kWoodPickaxe), 1);
}

TEST(World, NothingCanBeMadeAtTheLeftAndUpperEdge) {
  World world = Meadow();
  Stage(R"({"mat": [[1, 1, 11]], "inv": {"wood": 2}, "pos": [0, 1]})", &world);
  EXPECT_EQ(world.Step(Action::kMakeWoodSword).unlocked, 0u);
  Stage(R"({"mat": [[62, 62, 11]], "pos": [63, 63]})", &world);
  EXPECT_EQ(world.Step(Action::kMakeWoodSword).unlocked, Bit(Achievement::kMakeWoodSword));
}

TEST(World, PlacingCostsItemsAndNeedsAFreeCell) {
  World world = Meadow();
  Stage(R"({"inv": {"stone": 2}, "add": [[2, 32, 33]]})", &world);
  EXPECT_EQ(world.Step(Action::kPlaceStone).unlocked, 0u);
  world = Meadow();
  Stage(R"({"inv": {"stone": 2}})", &world);
  EXPECT_EQ(world.Step(Action::kPlaceStone).unlocked, Bit(Achievement::kPlaceStone));
  EXPECT_EQ(world.material({32, 33}), Material::kStone);
  EXPECT_EQ(ItemOf(world, Item::kStone), 1);
}

TEST(World, APlantRipensAndFeeds) {
  World world = Meadow();
  Stage(R"({"inv": {"sapling": 1, "food": 3}})", &world);
  EXPECT_EQ(world.Step(Action::kPlacePlant).unlocked, Bit(Achievement::kPlacePlant));
  ASSERT_EQ(world.objects().back().type, ObjectType::kPlant);
  EXPECT_EQ(world.objects().back().counter, 0);
  Stage(R"({"aux": [[32, 33, 299]]})", &world);
  EXPECT_EQ(world.Step(Action::kDo).unlocked, 0u);  // grown 299: eats nothing, then grows to 300
  EXPECT_EQ(world.Step(Action::kDo).unlocked, 0u);
  EXPECT_EQ(world.Step(Action::kDo).unlocked, Bit(Achievement::kEatPlant));
  EXPECT_EQ(ItemOf(world, Item::kFood), 7);
}

TEST(World, AnIronSwordDefeatsAZombieInOneHit) {
  World world = Meadow();
  Stage(R"({"add": [[3, 32, 33]], "inv": {"iron_sword": 1}})", &world);
  const StepOutcome outcome = world.Step(Action::kDo);
  EXPECT_EQ(outcome.unlocked, Bit(Achievement::kDefeatZombie));
  EXPECT_EQ(world.objects().size(), 1u);
}

TEST(World, AZombieDamagesASleepingPlayerMore) {
  World world = Meadow();
  Stage(R"({"add": [[3, 32, 33]], "inv": {"energy": 1}})", &world);
  EXPECT_EQ(world.Step(Action::kNoop).reward, -0.2);
  world = Meadow();
  Stage(R"({"add": [[3, 32, 33]], "inv": {"energy": 1}, "sleep": 1})", &world);
  EXPECT_EQ(world.Step(Action::kNoop).reward, -0.7);
}

TEST(World, AnArrowBreaksATable) {
  World world = Meadow();
  Stage(R"({"add": [[5, 40, 32, 1, 0]], "mat": [[42, 32, 11]]})", &world);
  world.Step(Action::kNoop);
  EXPECT_EQ(world.objects().back().position, (Position{41, 32}));
  EXPECT_EQ(world.material({42, 32}), Material::kTable);
  world.Step(Action::kNoop);
  EXPECT_EQ(world.objects().size(), 1u);
  EXPECT_EQ(world.material({42, 32}), Material::kPath);
}

TEST(World, SleepEndsWithFullEnergyAsAnAchievement) {
  World world = Meadow();
  Stage(R"({"inv": {"energy": 8}, "ctr": [0, 0, -10, 0]})", &world);
  world.Step(Action::kSleep);  // fatigue falls below -10: energy 9
  EXPECT_TRUE(world.player().sleeping);
  EXPECT_EQ(world.Step(Action::kNoop).unlocked, Bit(Achievement::kWakeUp));
  EXPECT_FALSE(world.player().sleeping);
}

TEST(World, FarObjectsAreNotUpdated) {
  World world = Meadow();
  Stage(R"({"add": [[6, 32, 15], [6, 32, 14]]})", &world);  // plants at distance 17 and 18
  world.Step(Action::kNoop);
  EXPECT_EQ(world.objects()[1].counter, 1);
  EXPECT_EQ(world.objects()[2].counter, 0);
}

TEST(World, SemanticViewShowsMaterialsAndObjects) {
  World world = Meadow();
  Stage(R"({"add": [[3, 10, 20]], "mat": [[63, 0, 12]]})", &world);
  std::vector<uint8_t> view(64 * 64);
  world.SemanticView(absl::MakeSpan(view));
  EXPECT_EQ(view[0], static_cast<int>(Material::kGrass));
  EXPECT_EQ(view[63 * 64], static_cast<int>(Material::kFurnace));
  EXPECT_EQ(view[32 * 64 + 32], 13);
  EXPECT_EQ(view[10 * 64 + 20], 15);
}

}  // namespace
}  // namespace craftfleet
