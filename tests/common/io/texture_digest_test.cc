#include "common/io/texture_digest.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// The published FNV-1a values for "a" (af63dc4c8601ec8c) and "" determine the constants; this value was computed with
// them.
TEST(TextureDigest, IsFnv1aOverNamesAndBytes) {
  TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "b.png", "two"), IsOk());
  ASSERT_THAT(WriteFileSynced(folder / "a.png", "one"), IsOk());
  ASSERT_THAT(WriteFileSynced(folder / "notes.txt", "ignored"), IsOk());
  const auto digest = TextureDigest(folder.path());
  ASSERT_THAT(digest, IsOk());
  EXPECT_EQ(*digest, "eadd0f0568c649e6");
}

TEST(TextureDigest, DependsOnNamesAndBytes) {
  TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "a.png", "one"), IsOk());
  const std::string first = *TextureDigest(folder.path());
  ASSERT_THAT(WriteFileSynced(folder / "a.png", "onf"), IsOk());
  EXPECT_NE(*TextureDigest(folder.path()), first);
  ASSERT_THAT(RenameSynced(folder / "a.png", folder / "c.png"), IsOk());
  ASSERT_THAT(WriteFileSynced(folder / "c.png", "one"), IsOk());
  EXPECT_NE(*TextureDigest(folder.path()), first);
}

TEST(TextureDigest, NamesAFolderWithoutTextures) {
  TempFolder folder;
  EXPECT_THAT(TextureDigest(folder.path()), StatusIs(absl::StatusCode::kNotFound, HasSubstr(folder.path())));
  EXPECT_THAT(TextureDigest(folder / "nowhere"), StatusIs(absl::StatusCode::kNotFound, HasSubstr("nowhere")));
}

}  // namespace
}  // namespace craftfleet
