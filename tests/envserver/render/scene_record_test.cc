#include "envserver/render/scene_record.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/env_name.h"
#include "envserver/render/renderer.h"
#include "envserver/world/world.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Of a record for the view of 9x7 cells.
constexpr int kLightAt = 1;
constexpr int kItemsAt = 9;
constexpr int kGroundAt = 17;
constexpr int kCountAt = kGroundAt + 63;
constexpr int kThingsAt = kCountAt + 2;

std::shared_ptr<const Renderer> MakeRenderer(const std::string& env = "crafter", const RenderOptions& picture = {}) {
  const WorldOptions world = WorldOptions::FromEnvName(*EnvName::Parse(env));
  return *Renderer::Create(*Textures::BuiltIn(), world, picture);
}

Sprite CowSprite() {
  Object cow;
  cow.type = ObjectType::kCow;
  return SpriteOf(cow, /*sleeping=*/false);
}

// A game, its records, and a reader of them.
struct RecordedGame {
  explicit RecordedGame(const std::shared_ptr<const Renderer>& its_renderer, int64_t seed)
      : renderer(its_renderer),
        world(*World::Create(renderer->world_options(), seed)),
        frame(renderer->frame_bytes()),
        drawn(renderer->frame_bytes()) {}

  // Draws the game's picture, and appends its record.
  void Record(std::string* out) {
    renderer->Capture(world, &scene);
    writer.Append(*renderer, scene, world.random(), out);
    renderer->Render(world, &world.random(), absl::MakeSpan(frame));
  }
  absl::Status Draw(absl::string_view bytes) {
    const absl::Status status = reader.Draw(*renderer, &bytes, absl::MakeSpan(drawn));
    return status.ok() && !bytes.empty() ? absl::InternalError("bytes are left") : status;
  }
  void SetDaylight(double daylight) { WorldEditor::State(&world).daylight = daylight; }

  const std::shared_ptr<const Renderer> renderer;
  World world;
  Scene scene;
  SceneWriter writer;
  SceneReader reader;
  std::vector<uint8_t> frame;
  std::vector<uint8_t> drawn;
};

std::string RecordOf(const std::shared_ptr<const Renderer>& renderer, double daylight) {
  RecordedGame game(renderer, 1);
  game.SetDaylight(daylight);
  std::string record;
  game.Record(&record);
  return record;
}

absl::Status DrawFresh(const std::shared_ptr<const Renderer>& renderer, const std::string& record) {
  return RecordedGame(renderer, 1).Draw(record);
}

// Random play, with the records of each 32 steps readable on their own, as those of a fragment.
TEST(SceneRecord, DrawsTheSameBytesAndIsSmallByDayAndNight) {
  RandomStream actions(5);
  int64_t bytes[2] = {0, 0};
  int64_t pictures[2] = {0, 0};
  for (int64_t seed = 0; seed < 5; ++seed) {
    RenderOptions picture;
    picture.width += static_cast<int>(seed) * 31;
    picture.height += static_cast<int>(seed) * 17;
    picture.inventory = seed != 3;
    RecordedGame game(MakeRenderer(seed < 2 ? "crafter" : "crafter:appearance=25/25/25/25", picture), seed);
    for (int step = 0; step < 1500; ++step) {
      if (step % 32 == 0) {
        game.writer.Restart();
        game.reader.Restart();
      }
      std::string record;
      game.Record(&record);
      ASSERT_THAT(game.Draw(record), IsOk());
      ASSERT_TRUE(game.drawn == game.frame) << "seed " << seed << ", step " << step;
      const bool night = game.world.daylight() < kNoiseBelow;
      bytes[night ? 1 : 0] += static_cast<int64_t>(record.size());
      ++pictures[night ? 1 : 0];
      if (game.world.Step(static_cast<Action>(actions.Below(kNumActions))).end != StepEnd::kNone) {
        game.world.Reset();
        game.writer.Restart();
      }
    }
  }
  const auto mean = [&](int i) { return static_cast<double>(bytes[i]) / static_cast<double>(pictures[i]); };
  ASSERT_GT(pictures[1], 500);
  RecordProperty("bytes_by_day", std::to_string(mean(0)));
  RecordProperty("bytes_by_night", std::to_string(mean(1)));
  EXPECT_LT(mean(0), 120);
  EXPECT_LT(mean(1), 300);
}

TEST(SceneRecord, AfterManyDrawsItHasTheStreamAgain) {
  RecordedGame game(MakeRenderer(), 1);
  game.SetDaylight(0);
  std::string first;
  game.Record(&first);
  ASSERT_THAT(game.Draw(first), IsOk());
  for (const int words : {kMaxWordsBetween, kMaxWordsBetween + 1}) {
    game.world.random().Skip(words);
    std::string record;
    game.Record(&record);
    EXPECT_EQ(record.size() > 2496, words > kMaxWordsBetween);
    ASSERT_THAT(game.Draw(record), IsOk());
    EXPECT_TRUE(game.drawn == game.frame);
  }
}

TEST(SceneRecord, NoiseNeedsTheStreamsState) {
  RecordedGame game(MakeRenderer(), 1);
  game.SetDaylight(0.2);
  std::string first;
  game.Record(&first);
  std::string second;
  game.Record(&second);
  EXPECT_THAT(game.Draw(second), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("noise without a stream")));
  ASSERT_THAT(game.Draw(first), IsOk());
  ASSERT_THAT(game.Draw(second), IsOk());
  EXPECT_TRUE(game.drawn == game.frame);
  game.reader.Restart();
  EXPECT_FALSE(game.Draw(second).ok());
}

TEST(SceneRecord, ACutOneIsRefused) {
  const auto renderer = MakeRenderer();
  for (const double daylight : {0.1, 0.9}) {
    const std::string record = RecordOf(renderer, daylight);
    ASSERT_THAT(DrawFresh(renderer, record), IsOk());
    for (size_t size = 1; size < record.size(); ++size) {
      EXPECT_THAT(DrawFresh(renderer, record.substr(0, size)),
                  StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("cut short")))
          << size;
    }
  }
}

// What a byte becomes, where, and the field that the error names; an empty one: allowed.
struct Edge {
  double daylight;
  int at;
  int value;
  std::string error;
};

TEST(SceneRecord, EdgesOfEachField) {
  const auto renderer = MakeRenderer();
  const int grass = SpriteOf(Material::kGrass, kNoVariant);
  const int grass_variant = SpriteOf(Material::kGrass, 0);
  const int tree_variant = SpriteOf(Material::kTree, 0);
  const int cow = CowSprite();
  const int cow_variant = cow + 1;
  // The things of a new world's record: at least the player.
  const std::vector<Edge> edges = {{0.9, 0, 1, ""},
                                   {0.9, 0, 2, "flags 2, want no stream by day"},
                                   {0.1, 0, 3, ""},
                                   {0.9, 0, 4, "flags 4, want 0..3"},
                                   {0.9, 0, 255, "flags"},
                                   {0.9, kItemsAt, 0x09, ""},
                                   {0.9, kItemsAt, 0x90, ""},
                                   {0.9, kItemsAt, 0x0a, "item 10, want 0..9"},
                                   {0.9, kItemsAt + 7, 0xa0, "item 10, want 0..9"},
                                   {0.9, kGroundAt, grass, ""},
                                   {0.9, kGroundAt + 62, kOutside, ""},
                                   {0.9, kGroundAt + 62, kOutside + 1, "ground 131"},
                                   {0.9, kGroundAt, 255, "ground 255"},
                                   {0.9, kGroundAt, cow, "ground"},
                                   {0.9, kGroundAt, grass_variant, "ground"},
                                   {0.9, kGroundAt, tree_variant, "ground"},
                                   {0.9, kCountAt, 64, "things 64, want 0..63"},
                                   {0.9, kCountAt + 1, 255, "things"},
                                   {0.9, kThingsAt + 1, 1, "cell"},
                                   {0.9, kThingsAt + 2, cow, ""},
                                   {0.9, kThingsAt + 2, cow_variant, "thing"},
                                   {0.9, kThingsAt + 2, grass, "thing"},
                                   {0.9, kThingsAt + 2, kOutside, "thing"},
                                   {0.9, kThingsAt + 2, 255, "thing"}};
  for (const Edge& edge : edges) {
    SCOPED_TRACE(edge.error + " " + std::to_string(edge.at) + " " + std::to_string(edge.value));
    std::string record = RecordOf(renderer, edge.daylight);
    record[edge.at] = static_cast<char>(edge.value);
    const absl::Status status = DrawFresh(renderer, record);
    if (edge.error.empty()) {
      EXPECT_THAT(status, IsOk());
    } else {
      EXPECT_THAT(status, StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(edge.error)));
    }
  }
}

TEST(SceneRecord, EdgesOfDaylight) {
  const auto renderer = MakeRenderer();
  const double least = std::numeric_limits<double>::denorm_min();
  const double infinity = std::numeric_limits<double>::infinity();
  const auto with = [&](double daylight) {
    std::string record = RecordOf(renderer, daylight < kNoiseBelow ? 0.1 : 0.9);
    std::memcpy(&record[kLightAt], &daylight, sizeof(daylight));
    return DrawFresh(renderer, record);
  };
  for (const double good : {0.0, least, std::nextafter(kNoiseBelow, 0), kNoiseBelow, 1.0}) {
    EXPECT_THAT(with(good), IsOk()) << good;
  }
  for (const double bad : {-least, std::nextafter(1.0, 2), infinity, -infinity, std::nan("")}) {
    EXPECT_THAT(with(bad), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("daylight"))) << bad;
  }
}

TEST(SceneRecord, EdgesOfTheStreamAndOfTheWordsBetween) {
  const auto renderer = MakeRenderer();
  RecordedGame game(renderer, 1);
  game.SetDaylight(0.1);
  std::string first;
  game.Record(&first);
  std::string second;
  game.Record(&second);
  const size_t position_at = second.size() - 2;
  const auto put = [position_at](int value, std::string record) {
    record[position_at] = static_cast<char>(value & 255);
    record[position_at + 1] = static_cast<char>(value >> 8);
    return record;
  };
  EXPECT_THAT(game.Draw(put(624, first)), IsOk());
  EXPECT_THAT(game.Draw(put(625, first)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("position 625, want 0..624")));
  EXPECT_THAT(game.Draw(put(0, first)), IsOk());
  EXPECT_THAT(game.Draw(put(kMaxWordsBetween, second)), IsOk());
  EXPECT_THAT(game.Draw(put(kMaxWordsBetween + 1, second)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("words 37441, want 0..37440")));
}

TEST(SceneRecord, CellsOfThingsAscend) {
  const auto renderer = MakeRenderer();
  Scene scene;
  scene.ground.assign(63, SpriteOf(Material::kGrass, kNoVariant));
  const auto cow = static_cast<uint8_t>(CowSprite());
  const auto draw = [&](const std::vector<int>& cells) {
    scene.things.clear();
    for (const int cell : cells) scene.things.push_back({static_cast<uint16_t>(cell), cow});
    scene.daylight = 1;
    std::string record;
    SceneWriter().Append(*renderer, scene, RandomStream(), &record);
    return DrawFresh(renderer, record);
  };
  std::vector<int> all(63);
  for (int cell = 0; cell < 63; ++cell) all[cell] = cell;
  EXPECT_THAT(draw({}), IsOk());
  EXPECT_THAT(draw(all), IsOk());
  EXPECT_THAT(draw({5, 5}), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("cell 5, want 6..62")));
  EXPECT_THAT(draw({5, 4}), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("cell 4, want 6..62")));
  EXPECT_THAT(draw({62}), IsOk());
  EXPECT_THAT(draw({63}), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("cell 63, want 0..62")));
}

}  // namespace
}  // namespace craftfleet
