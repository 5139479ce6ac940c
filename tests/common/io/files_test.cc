#include "common/io/files.h"

#include <sys/stat.h>
#include <unistd.h>

#include <fstream>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/plain_user.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(Files, ReadReturnsWhatWasWritten) {
  const TempFolder folder;
  const std::string bytes = std::string(3'000'000, 'x') + std::string("\0\n\xFF", 3);
  ASSERT_THAT(WriteFileSynced(folder / "a", bytes), IsOk());
  EXPECT_EQ(ReadFile(folder / "a").value(), bytes);
  ASSERT_THAT(WriteFileSynced(folder / "a", "short"), IsOk());
  EXPECT_EQ(ReadFile(folder / "a").value(), "short");
}

TEST(Files, ErrorsNameThePath) {
  const TempFolder folder;
  EXPECT_THAT(ReadFile(folder / "absent"), StatusIs(absl::StatusCode::kNotFound, HasSubstr(folder / "absent")));
  EXPECT_THAT(ListFolder(folder / "absent"), StatusIs(absl::StatusCode::kNotFound, HasSubstr(folder / "absent")));
  EXPECT_THAT(WriteFileSynced(folder / "absent/a", ""),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr(folder / "absent/a")));
}

TEST(Files, AFullDeviceIsResourceExhausted) {
  EXPECT_THAT(WriteFileSynced("/dev/full", "x"),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("No space left")));
}

TEST(Files, ReplaceKeepsTheOldBytesWhenItFails) {
  const TempFolder folder;
  ASSERT_THAT(ReplaceFile(folder / "a", "old"), IsOk());
  {
    const FileSizeLimit limit(1000);
    EXPECT_THAT(ReplaceFile(folder / "a", std::string(2000, 'n')),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr(folder / "a")));
  }
  EXPECT_EQ(ReadFile(folder / "a").value(), "old");
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("a"));
  ASSERT_THAT(ReplaceFile(folder / "a", "new"), IsOk());
  EXPECT_EQ(ReadFile(folder / "a").value(), "new");
}

TEST(Files, ReplaceKeepsTheMode) {
  const TempFolder folder;
  const std::string path = folder / "a";
  ASSERT_THAT(WriteFileSynced(path, "old"), IsOk());
  ASSERT_EQ(::chmod(path.c_str(), 0600), 0);
  ASSERT_THAT(ReplaceFile(path, "new"), IsOk());
  struct stat replaced = {};
  ASSERT_EQ(::stat(path.c_str(), &replaced), 0);
  EXPECT_EQ(replaced.st_mode & 07777, 0600U);
}

TEST(Files, AFileIsReplacedInAFolderThatMayNotBeRead) {
  const TempFolder folder;
  ASSERT_EQ(::chmod(folder.path().c_str(), 0333), 0);
  {
    const PlainUser user;
    EXPECT_THAT(ReplaceFile(folder / "a", "new"), IsOk());
  }
  ASSERT_EQ(::chmod(folder.path().c_str(), 0700), 0);
  EXPECT_EQ(ReadFile(folder / "a").value(), "new");
}

TEST(Files, RemovesOnlyWhatReplaceLeft) {
  const TempFolder folder;
  for (const char* name : {"a.tmp", ".craftfleet-12-3.tmp", ".craftfleet-12-4.mp4"}) {
    ASSERT_THAT(WriteFileSynced(folder / name, "half"), IsOk());
  }
  EXPECT_THAT(RemoveUnfinished(folder.path()), IsOk());
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre(".craftfleet-12-4.mp4", "a.tmp"));
}

TEST(Files, RenameWorksForRelativeNames) {
  const TempFolder folder;
  ASSERT_EQ(::chdir(folder.path().c_str()), 0);
  ASSERT_THAT(WriteFileSynced("a", "1"), IsOk());
  EXPECT_THAT(RenameSynced("a", "b"), IsOk());
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("b"));
  ASSERT_EQ(::chdir("/"), 0);  // the next test's folder must exist
}

TEST(Files, FoldersAreCreatedListedAndRemoved) {
  const TempFolder folder;
  EXPECT_THAT(CreateFolders(folder / "x/y"), IsOk());
  EXPECT_THAT(CreateFolders(folder / "x/y"), IsOk());
  EXPECT_THAT(CreateFolders(folder / "b"), IsOk());
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("b", "x"));
  EXPECT_THAT(RemoveAll(folder / "x"), IsOk());
  EXPECT_THAT(RemoveAll(folder / "x"), IsOk());
  EXPECT_FALSE(PathExists(folder / "x"));
  ASSERT_THAT(WriteFileSynced(folder / "f", ""), IsOk());
  EXPECT_THAT(CreateFolders(folder / "f/g"), testing::Not(IsOk()));
}

// As a learner that has lost its run folder does for a moment.
TEST(Files, AFolderIsRemovedWhileAnotherStillWritesToIt) {
  const TempFolder folder;
  for (int i = 0; i < 300; ++i) {
    ASSERT_THAT(CreateFolders(folder / "x"), IsOk());
    std::thread other([&] {
      for (const char* name : {"x/a", "x/b", "x/c", "x/d", "x/e", "x/f"}) std::ofstream(folder / name) << name;
    });
    const absl::Status removed = RemoveAll(folder / "x");
    other.join();
    ASSERT_THAT(removed, IsOk());
    ASSERT_FALSE(PathExists(folder / "x"));
  }
}

TEST(Files, JoinPathInsertsOneSlash) {
  EXPECT_EQ(JoinPath("a", "b"), "a/b");
  EXPECT_EQ(JoinPath("a/", "b"), "a/b");
}

}  // namespace
}  // namespace craftfleet
