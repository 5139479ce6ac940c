#include "envserver/canary.h"

#include <cstdlib>
#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/known_canary.h"
#include "common/io/texture_digest.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

const std::string kBuiltIn = SourcePath("envserver/textures");

std::string CanaryOf(const std::string& folder) {
  const auto textures = Textures::Load(folder);
  return textures.ok() ? GameCanary(**textures).value_or("failed") : std::string(textures.status().message());
}

// Fails after a change of rules, pictures or textures: put the new canary into common/config/known_canary.h. Workers of
// earlier builds and of later ones then refuse to work together.
TEST(GameCanary, OfTheBuiltInTexturesMatchesTheKnownOne) {
  EXPECT_EQ(TextureDigest(kBuiltIn).value_or(""), kBuiltInTextures);
  EXPECT_EQ(CanaryOf(kBuiltIn), kBuiltInGameCanary);
  EXPECT_EQ(KnownGameCanary(kBuiltInTextures), kBuiltInGameCanary);
  EXPECT_EQ(KnownGameCanary("another"), "");
}

TEST(GameCanary, DependsOnTextures) {
  const TempFolder folder;
  ASSERT_EQ(std::system(absl::StrCat("cp ", kBuiltIn, "/*.png ", folder.path(), " && cp ", folder / "stone.png", " ",
                                     folder / "grass.png")
                            .c_str()),
            0);
  EXPECT_NE(CanaryOf(folder.path()), kBuiltInGameCanary);
  EXPECT_EQ(CanaryOf(folder.path()), CanaryOf(folder.path()));
}

}  // namespace
}  // namespace craftfleet
