#include "common/watched_file.h"

#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/files.h"
#include "common/mutex.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::Eq;
using testing::Optional;

TEST(WatchedFile, IsReadAgainWhenItChanges) {
  const TempFolder folder;
  ASSERT_THAT(ReplaceFile(folder / "f", "one"), IsOk());
  WatchedFile file(folder / "f");
  EXPECT_THAT(file.ReadIfChanged(), Optional(Eq("one")));
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
  ASSERT_THAT(ReplaceFile(folder / "f", "two"), IsOk());
  EXPECT_THAT(file.ReadIfChanged(), Optional(Eq("two")));
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
}

TEST(WatchedFile, MayBeAwayForAWhile) {
  const TempFolder folder;
  WatchedFile file(folder / "f");
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
  ASSERT_THAT(ReplaceFile(folder / "f", "here"), IsOk());
  EXPECT_THAT(file.ReadIfChanged(), Optional(Eq("here")));
  std::filesystem::remove(folder / "f");
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
}

// What a watch has told; shared with its thread.
class Told {
 public:
  void Add(std::string text) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    all_.push_back(std::move(text));
  }
  std::vector<std::string> all() const ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    return all_;
  }

 private:
  mutable Mutex mu_;
  std::vector<std::string> all_ ABSL_GUARDED_BY(mu_);
};

TEST(FileWatch, TellsOfChangesAlone) {
  const TempFolder folder;
  ASSERT_THAT(ReplaceFile(folder / "f", "one"), IsOk());
  const auto told = std::make_shared<Told>();
  const FileWatch watch(folder / "f", "one", [told](std::string text) { told->Add(std::move(text)); });
  EXPECT_FALSE(WaitUntil([&] { return !told->all().empty(); }, absl::Seconds(2.5))) << "it is as it was";
  ASSERT_THAT(ReplaceFile(folder / "f", "two"), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return !told->all().empty(); }));
  EXPECT_THAT(told->all(), ElementsAre("two"));
}

TEST(FileWatch, EndsAtOnceWhileItsThreadHangs) {
  const TempFolder folder;
  const std::string path = folder / "f";
  // As on a disk that hangs: who opens a FIFO waits until somebody writes to it.
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  const auto told = std::make_shared<Told>();
  auto watch = std::make_unique<FileWatch>(path, "", [told](std::string text) { told->Add(std::move(text)); });
  absl::SleepFor(absl::Seconds(1.5));  // a look is due
  const absl::Time begin = absl::Now();
  watch = nullptr;
  EXPECT_LT(absl::Now() - begin, absl::Seconds(5));
  // Lets the thread go; it ends by itself.
  std::ofstream(path) << "late";
  EXPECT_TRUE(WaitUntil([&] { return told.use_count() == 1; }));
}

}  // namespace
}  // namespace craftfleet
