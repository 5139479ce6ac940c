#include "common/watched_file.h"

#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/files.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::Eq;
using testing::Optional;

TEST(WatchedFile, IsReadAgainWhenItChangesAtMostOnceASecond) {
  const TempFolder folder;
  FakeClock clock;
  ASSERT_THAT(ReplaceFile(folder / "f", "one"), IsOk());
  WatchedFile file(folder / "f", &clock);
  EXPECT_THAT(file.ReadIfChanged(), Optional(Eq("one")));
  ASSERT_THAT(ReplaceFile(folder / "f", "two"), IsOk());
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
  clock.Advance(absl::Seconds(1));
  EXPECT_THAT(file.ReadIfChanged(), Optional(Eq("two")));
  clock.Advance(absl::Seconds(1));
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
}

TEST(WatchedFile, MayBeAwayForAWhile) {
  const TempFolder folder;
  FakeClock clock;
  WatchedFile file(folder / "f", &clock);
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
  ASSERT_THAT(ReplaceFile(folder / "f", "here"), IsOk());
  clock.Advance(absl::Seconds(1));
  EXPECT_THAT(file.ReadIfChanged(), Optional(Eq("here")));
  std::filesystem::remove(folder / "f");
  clock.Advance(absl::Seconds(1));
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
}

}  // namespace
}  // namespace craftfleet
