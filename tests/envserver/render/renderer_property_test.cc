// Random situations at random sizes: the fast renderer and the plain one must draw the same.

#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/io/paths.h"
#include "envserver/render/renderer.h"
#include "envserver/render/scene_record.h"
#include "tests/envserver/render/plain_renderer.h"
#include "tests/fakes/cpu_paths.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

int Between(int low, int high, RandomStream* random) { return low + static_cast<int>(random->Below(high - low + 1)); }

WorldOptions RandomOptions(RandomStream* random) {
  WorldOptions options;
  options.width = Between(4, 40, random);
  options.height = Between(4, 40, random);
  options.view_width = Between(1, 17, random);
  options.view_height = options.inventory_rows() + Between(1, 9, random);
  if (random->Below(2) == 0) {
    options.appearance = "tczsuk";
    options.percentages = {25, 25, 25, 25};
  }
  return options;
}

// Randomises daylight, inventory and some materials, and plays some steps.
void Shuffle(RandomStream* random, World* world) {
  for (int i = 0; i < 20; ++i) world->Step(static_cast<Action>(random->Below(kNumActions)));
  WorldState& state = WorldEditor::State(world);
  for (int i = 0; i < 100; ++i) {
    const Position p = {Between(0, world->options().width - 1, random),
                        Between(0, world->options().height - 1, random)};
    state.board.SetMaterial(p, static_cast<Material>(Between(1, kNumMaterials - 1, random)), kNoVariant);
  }
  for (int8_t& amount : state.player.inventory) amount = static_cast<int8_t>(Between(0, kMaxItem, random));
  const double lights[] = {0, 0.4999999, 0.5, 1, random->Uniform(), random->Uniform() / 2};
  state.daylight = lights[random->Below(6)];
  state.player.sleeping = random->Below(3) == 0;
}

class RendererProperty : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(RendererProperty);

TEST_P(RendererProperty, MatchesThePlainRenderer) {
  const auto textures = Textures::Load(*DefaultTextureDir());
  ASSERT_THAT(textures, IsOk());
  for (int seed = 0; seed < 150; ++seed) {
    SCOPED_TRACE(seed);
    RandomStream random(seed);
    const WorldOptions options = RandomOptions(&random);
    RenderOptions picture;
    // Up to 34 pixels a cell: beyond the widths of the copies' groups.
    picture.width = options.view_width * Between(2, 34, &random) + Between(0, 3, &random);
    picture.height = options.view_height * Between(2, 34, &random) + Between(0, 3, &random);
    picture.inventory = random.Below(4) != 0;
    const auto renderer = Renderer::Create(**textures, options, picture);
    ASSERT_THAT(renderer, IsOk());
    absl::StatusOr<World> world = World::Create(options, seed);
    ASSERT_THAT(world, IsOk());
    Shuffle(&random, &*world);

    RandomStream plain_stream = world->random();
    const std::vector<uint8_t> plain = PlainPicture(**textures, *world, picture, &plain_stream);
    std::vector<uint8_t> frame((*renderer)->frame_bytes(), 99);
    (*renderer)->Render(*world, &world->random(), absl::MakeSpan(frame));
    EXPECT_EQ(world->random().position(), plain_stream.position());
    EXPECT_EQ(world->random().state(), plain_stream.state());
    for (size_t i = 0; i < frame.size(); ++i) {
      ASSERT_EQ(frame[i], plain[i]) << "x " << i / 3 % picture.width << ", y " << i / 3 / picture.width << ", size "
                                    << picture.width << "x" << picture.height << ", light " << world->daylight();
    }
  }
}

// Situations of one game after another: the reader that had all records before draws each picture from its record.
TEST_P(RendererProperty, RecordsDrawTheSamePictures) {
  for (int seed = 0; seed < 60; ++seed) {
    SCOPED_TRACE(seed);
    RandomStream random(seed);
    const WorldOptions options = RandomOptions(&random);
    RenderOptions picture;
    picture.width = options.view_width * Between(2, 20, &random) + Between(0, 3, &random);
    picture.height = options.view_height * Between(2, 20, &random) + Between(0, 3, &random);
    picture.inventory = random.Below(4) != 0;
    const auto renderer = Renderer::Create(*Textures::BuiltIn(), options, picture);
    ASSERT_THAT(renderer, IsOk());
    absl::StatusOr<World> world = World::Create(options, seed);
    ASSERT_THAT(world, IsOk());
    std::vector<uint8_t> frame((*renderer)->frame_bytes());
    std::vector<uint8_t> drawn((*renderer)->frame_bytes());
    SceneWriter writer;
    SceneReader reader;
    Scene scene;
    for (int i = 0; i < 12; ++i) {
      Shuffle(&random, &*world);
      if (random.Below(4) == 0) writer.Restart();
      (*renderer)->Capture(*world, &scene);
      std::string record;
      writer.Append(**renderer, scene, world->random(), &record);
      (*renderer)->Render(*world, &world->random(), absl::MakeSpan(frame));
      absl::string_view rest = record;
      ASSERT_THAT(reader.Draw(**renderer, &rest, absl::MakeSpan(drawn)), IsOk());
      ASSERT_TRUE(rest.empty());
      ASSERT_TRUE(drawn == frame) << i << ", light " << world->daylight();
    }
  }
}

}  // namespace
}  // namespace craftfleet
