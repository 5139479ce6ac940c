#include "learner/run/epoch.h"

#include <unistd.h>

#include <string>

#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/range_check.h"
#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(Epoch, CountsStarts) {
  const TempFolder folder;
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 0);
  EpochFence first, second;
  ASSERT_THAT(first.Take(folder.path(), 1), IsOk());
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 1);
  ASSERT_THAT(second.Take(folder.path(), 2), IsOk());
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 2);
  const std::string lines = ReadFile(folder / "epoch").value();
  for (const char* garbage : {"", "x", "-1", "0", "1 2"}) {
    ASSERT_THAT(WriteFileSynced(folder / "epoch", garbage), IsOk());
    EXPECT_THAT(ReadEpoch(folder.path()), StatusIs(absl::StatusCode::kDataLoss, HasSubstr(folder / "epoch")))
        << garbage;
    // Its own lines, unlike a number, let it go on.
    EXPECT_THAT(second.Check(), StatusIs(absl::StatusCode::kUnavailable,
                                         AllOf(HasSubstr(folder / "epoch"), HasSubstr(absl::CEscape(lines)),
                                               Not(HasSubstr("write the number")))))
        << garbage;
  }
  ASSERT_THAT(WriteFileSynced(folder / "epoch", lines), IsOk());
  EXPECT_THAT(second.Check(), IsOk());
}

TEST(Epoch, ReadsAFileThatSomebodyRepaired) {
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "epoch", "7\n"), IsOk());
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 7);
  EpochFence fence;
  EXPECT_THAT(fence.Take(folder.path(), 7), StatusIs(absl::StatusCode::kFailedPrecondition, testing::_));
  EXPECT_THAT(fence.Take(folder.path(), 8), IsOk());
}

TEST(Epoch, ANumberWithoutOneAfterItIsRefused) {
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "epoch", absl::StrCat(kMaxCount - 1)), IsOk());
  EXPECT_EQ(ReadEpoch(folder.path()).value(), kMaxCount - 1);
  for (const char* large : {"4503599627370496", "4611686018427387904", "9223372036854775807"}) {
    ASSERT_THAT(WriteFileSynced(folder / "epoch", large), IsOk());
    EXPECT_THAT(ReadEpoch(folder.path()),
                StatusIs(absl::StatusCode::kDataLoss, AllOf(HasSubstr(folder / "epoch"), HasSubstr(large),
                                                            HasSubstr("want 1..4503599627370495: write"))));
  }
}

TEST(EpochFence, OnlyTheLatestStartMayWrite) {
  const TempFolder folder;
  EpochFence older, newer;
  EXPECT_THAT(older.Check(), StatusIs(absl::StatusCode::kFailedPrecondition, testing::_));
  ASSERT_THAT(older.Take(folder.path(), 1), IsOk());
  EXPECT_THAT(older.Check(), IsOk());
  EXPECT_THAT(newer.Take(folder.path(), 1),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr(absl::StrCat("process ", ::getpid()))));
  ASSERT_THAT(newer.Take(folder.path(), 2), IsOk());
  EXPECT_THAT(newer.Check(), IsOk());
  EXPECT_THAT(older.Check(),
              StatusIs(absl::StatusCode::kAborted,
                       AllOf(HasSubstr(folder.path()), HasSubstr(absl::StrCat("taken over by process ", ::getpid())),
                             HasSubstr("epoch 2, this one is epoch 1"))));
}

// The content may be long and binary; the error is one short line.
TEST(Epoch, ADamagedFileIsReportedInOneLine) {
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "epoch", std::string(5000, '\x1b') + "\nprocess 7"), IsOk());
  const absl::Status status = ReadEpoch(folder.path()).status();
  EXPECT_THAT(status.message(), HasSubstr("write the number of starts"));
  EXPECT_EQ(status.message().find('\n'), absl::string_view::npos);
  EXPECT_EQ(status.message().find('\x1b'), absl::string_view::npos);
  EXPECT_LT(status.message().size(), 500U);
}

// Two starts read the same number at the same time.
TEST(EpochFence, OfTwoStartsWithOneNumberOnlyTheLastMayWrite) {
  const TempFolder folder, elsewhere;
  EpochFence first, last;
  ASSERT_THAT(first.Take(folder.path(), 3), IsOk());
  ASSERT_THAT(last.Take(elsewhere.path(), 3), IsOk());
  ASSERT_THAT(WriteFileSynced(folder / "epoch", ReadFile(elsewhere / "epoch").value()), IsOk());
  EXPECT_THAT(first.Check(), StatusIs(absl::StatusCode::kAborted, testing::_));
}

}  // namespace
}  // namespace craftfleet
