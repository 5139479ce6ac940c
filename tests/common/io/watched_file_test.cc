#include "common/io/watched_file.h"

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

#include "common/base/mutex.h"
#include "common/io/files.h"
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

TEST(WatchedFile, MayBeMissingForAWhile) {
  const TempFolder folder;
  WatchedFile file(folder / "f");
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
  ASSERT_THAT(ReplaceFile(folder / "f", "here"), IsOk());
  EXPECT_THAT(file.ReadIfChanged(), Optional(Eq("here")));
  std::filesystem::remove(folder / "f");
  EXPECT_EQ(file.ReadIfChanged(), std::nullopt);
}

// The contents that a watch has reported; shared with its thread.
class Reported {
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

TEST(FileWatch, ReportsOnlyChanges) {
  const TempFolder folder;
  ASSERT_THAT(ReplaceFile(folder / "f", "one"), IsOk());
  const auto reported = std::make_shared<Reported>();
  const FileWatch watch(folder / "f", "one", [reported](std::string text) { reported->Add(std::move(text)); });
  EXPECT_FALSE(WaitUntil([&] { return !reported->all().empty(); }, absl::Seconds(2.5))) << "it has not changed";
  ASSERT_THAT(ReplaceFile(folder / "f", "two"), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return !reported->all().empty(); }));
  EXPECT_THAT(reported->all(), ElementsAre("two"));
}

TEST(FileWatch, DestructorDoesNotWaitForAHangingRead) {
  const TempFolder folder;
  const std::string path = folder / "f";
  // Simulates a hanging disk: opening a FIFO blocks until it has a writer.
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  const auto reported = std::make_shared<Reported>();
  auto watch = std::make_unique<FileWatch>(path, "", [reported](std::string text) { reported->Add(std::move(text)); });
  absl::SleepFor(absl::Seconds(1.5));  // longer than the interval between checks
  const absl::Time begin = absl::Now();
  watch = nullptr;
  EXPECT_LT(absl::Now() - begin, absl::Seconds(5));
  // Unblocks the thread, which then ends.
  std::ofstream(path) << "late";
  EXPECT_TRUE(WaitUntil([&] { return reported.use_count() == 1; }));
}

}  // namespace
}  // namespace craftfleet
