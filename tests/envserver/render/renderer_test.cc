#include "envserver/render/renderer.h"

#include <filesystem>
#include <memory>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/paths.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace renderer_test {

using testing::AllOf;
using testing::Each;
using testing::HasSubstr;

std::shared_ptr<const Textures> OwnTextures() { return *Textures::Load(*DefaultTextureDir()); }

TEST(RenderOptions, SizesBelowTwoPixelsACellAreRefused) {
  WorldOptions world;
  RenderOptions options;
  options.width = 17;
  EXPECT_THAT(options.Validate(world), StatusIs(absl::StatusCode::kInvalidArgument,
                                                AllOf(HasSubstr("width 17"), HasSubstr("want 18..2048 pixels"))));
  options.width = 18;
  EXPECT_THAT(options.Validate(world), IsOk());
  options.height = 2049;
  EXPECT_THAT(options.Validate(world),
              StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("height 2049"), HasSubstr("9 cells"))));
}

TEST(Renderer, OptionsAreChecked) {
  RenderOptions picture;
  picture.height = 0;
  EXPECT_THAT(Renderer::Create(*OwnTextures(), WorldOptions(), picture),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("height 0")));
  WorldOptions world;
  world.view_width = 64;
  EXPECT_THAT(Renderer::Create(*OwnTextures(), world, RenderOptions()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("view_width 64")));
}

TEST(Renderer, AMissingVariantTextureIsNamedIfItIsNeeded) {
  TempFolder folder;
  std::filesystem::copy(*DefaultTextureDir(), folder.path(), std::filesystem::copy_options::recursive);
  std::filesystem::remove(folder / "cow2.png");
  const auto textures = Textures::Load(folder.path());
  ASSERT_THAT(textures, IsOk());

  WorldOptions world;
  EXPECT_THAT(Renderer::Create(**textures, world, RenderOptions()), IsOk());
  world.appearance = "tzsuk";
  EXPECT_THAT(Renderer::Create(**textures, world, RenderOptions()), IsOk());
  world.appearance = "tczsuk";
  EXPECT_THAT(Renderer::Create(**textures, world, RenderOptions()),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("cow2.png")));
}

// A new world whose daylight is set to `daylight`.
World WorldAt(double daylight) {
  World world = *World::Create(WorldOptions(), 3);
  WorldEditor::State(&world).daylight = daylight;
  return world;
}

TEST(Renderer, TakesOneDrawPerPixelBelowHalfDaylight) {
  const auto renderer = Renderer::Create(*OwnTextures(), WorldOptions(), RenderOptions());
  ASSERT_THAT(renderer, IsOk());
  std::vector<uint8_t> frame((*renderer)->frame_bytes());
  for (const double daylight : {0.5, 0.499}) {
    World world = WorldAt(daylight);
    RandomStream expected = world.random();
    if (daylight < 0.5) expected.Skip(2 * 63 * 49);
    (*renderer)->Render(world, &world.random(), absl::MakeSpan(frame));
    EXPECT_EQ(world.random().position(), expected.position());
    EXPECT_EQ(world.random().state(), expected.state());
  }
}

TEST(Renderer, WritesEveryByteOfTheFrameAndLeavesTheBorderBlack) {
  RenderOptions options;
  options.width = 70;
  options.height = 76;
  const auto renderer = Renderer::Create(*OwnTextures(), WorldOptions(), options);
  ASSERT_THAT(renderer, IsOk());
  for (const double daylight : {0.9, 0.1}) {
    World world = WorldAt(daylight);
    RandomStream stream = world.random();
    std::vector<uint8_t> first((*renderer)->frame_bytes(), 0);
    (*renderer)->Render(world, &stream, absl::MakeSpan(first));
    stream = world.random();
    std::vector<uint8_t> second((*renderer)->frame_bytes(), 255);
    (*renderer)->Render(world, &stream, absl::MakeSpan(second));
    EXPECT_EQ(first, second);
    for (int y = 0; y < 76; ++y) {
      for (int x = 0; x < 70; ++x) {
        if (x >= 3 && x < 66 && y >= 2 && y < 74) continue;
        EXPECT_THAT(absl::MakeConstSpan(first).subspan((y * 70 + x) * 3, 3), Each(0)) << x << " " << y;
      }
    }
  }
}

TEST(RendererDeathTest, AFrameOfAnotherSizeAborts) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";  // OpenCV's libraries start threads
  const auto renderer = Renderer::Create(*OwnTextures(), WorldOptions(), RenderOptions());
  ASSERT_THAT(renderer, IsOk());
  World world = WorldAt(1);
  std::vector<uint8_t> frame((*renderer)->frame_bytes() - 1);
  EXPECT_DEATH((*renderer)->Render(world, &world.random(), absl::MakeSpan(frame)), "broken invariant");
}

}  // namespace renderer_test
}  // namespace craftfleet
