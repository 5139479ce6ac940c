#include "common/io/paths.h"

#include <filesystem>

#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

TEST(DefaultTextureDir, IsFoundFromAnyWorkingDirectory) {
  const auto before = DefaultTextureDir();
  ASSERT_THAT(before, IsOk());
  EXPECT_TRUE(PathExists(JoinPath(*before, "player-left.png")));
  const std::filesystem::path here = std::filesystem::current_path();
  std::filesystem::current_path("/");
  const auto from_root = DefaultTextureDir();
  std::filesystem::current_path(here);
  ASSERT_THAT(from_root, IsOk());
  EXPECT_EQ(*from_root, *before);
}

}  // namespace
}  // namespace craftfleet
