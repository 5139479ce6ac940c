#include "tests/integration/process.h"

#include <signal.h>

#include <gmock/gmock.h>
#include <gtest/gtest-spi.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

TEST(Process, IsKilledWithItsObject) {
  const TempFolder folder;
  pid_t pid = 0;
  {
    auto process = Process::Start("/bin/sh", {"-c", "trap '' TERM; exec sleep 60"}, folder / "p");
    ASSERT_THAT(process, IsOk());
    pid = (*process)->pid();
    EXPECT_EQ(kill(pid, 0), 0);
  }
  EXPECT_NE(kill(pid, 0), 0);
}

TEST(Process, ThatCrashesFailsATestThatDoesNotWaitForIt) {
  const TempFolder folder;
  const auto run = [&](const std::string& script) {
    const auto process = Process::Start("/bin/sh", {"-c", script}, folder / "p");
    EXPECT_FALSE((*process)->WaitForText("never printed", absl::Seconds(10)));
  };
  run("exit 1");
  run("kill -TERM $$");
  EXPECT_NONFATAL_FAILURE(run("echo why >&2; kill -SEGV $$"), "ended by itself with 139:\nwhy");
  EXPECT_NONFATAL_FAILURE(run("echo '==7==ERROR: AddressSanitizer: heap-use-after-free' >&2; exit 1"),
                          "heap-use-after-free");
}

TEST(Process, FindsAnAddressOnceItsLineIsComplete) {
  const TempFolder folder;
  auto process = Process::Start(
      "/bin/sh", {"-c", "printf 'x info: listening on 127.0.0.1:4' >&2; sleep 0.1; echo '1234 now' >&2; exec sleep 60"},
      folder / "p");
  ASSERT_THAT(process, IsOk());
  const auto address = (*process)->WaitForAddress();
  ASSERT_THAT(address, IsOk());
  EXPECT_EQ(*address, "127.0.0.1:41234");
  EXPECT_TRUE((*process)->WaitForText("now", absl::Seconds(10)));
}

TEST(Process, StopsWaitingWhenTheProcessEnded) {
  const TempFolder folder;
  auto process = Process::Start("/bin/sh", {"-c", "echo broken >&2"}, folder / "p");
  ASSERT_THAT(process, IsOk());
  EXPECT_FALSE((*process)->WaitForText("listening", absl::InfiniteDuration()));
  EXPECT_THAT((*process)->WaitForAddress("status on ", absl::InfiniteDuration()),
              StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("broken")));
}

}  // namespace
}  // namespace craftfleet
