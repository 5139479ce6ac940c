#include "actor/permit_book.h"

#include <set>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

HeldPermit Permit(int lane, int64_t fragment = 0) { return {1, lane, fragment, 10}; }

TEST(PermitBook, LanesOfOneTileGoToOneLoop) {
  PermitBook book(2);
  book.SetTile(4);
  for (int lane = 0; lane < 16; ++lane) book.Add(Permit(lane));
  std::vector<int> lanes[2];
  for (int loop = 0; loop < 2; ++loop) {
    for (const HeldPermit& permit : book.Take(loop)) lanes[loop].push_back(permit.lane);
  }
  EXPECT_THAT(lanes[0], ElementsAre(0, 1, 2, 3, 8, 9, 10, 11));
  EXPECT_THAT(lanes[1], ElementsAre(4, 5, 6, 7, 12, 13, 14, 15));
}

TEST(PermitBook, APermitGivenTwiceIsPlayedOnce) {
  PermitBook book(1);
  book.Add(Permit(3));
  book.Add(Permit(3));
  EXPECT_THAT(book.Take(0), ElementsAre(Permit(3)));
  book.Add(Permit(3));  // is being played
  book.Add(Permit(4));
  EXPECT_THAT(book.Take(0), ElementsAre(Permit(4)));
}

TEST(PermitBook, APermitIsAtHandUntilItIsReleased) {
  PermitBook book(1);
  book.Add(Permit(0));
  book.Add(Permit(1));
  EXPECT_THAT(book.Active(), ElementsAre(Permit(0), Permit(1)));
  book.Take(0);
  EXPECT_THAT(book.Active(), ElementsAre(Permit(0), Permit(1)));
  book.Release(Permit(0));
  book.Release(Permit(7));
  EXPECT_THAT(book.Active(), ElementsAre(Permit(1)));
  book.Add(Permit(0));  // given again after it was released
  EXPECT_THAT(book.Take(0), ElementsAre(Permit(0)));
}

TEST(PermitBook, FragmentEpochAndVersionTellPermitsApart) {
  PermitBook book(1);
  for (const HeldPermit& permit :
       {HeldPermit{1, 0, 0, 10}, HeldPermit{1, 0, 1, 10}, HeldPermit{2, 0, 0, 10}, HeldPermit{1, 0, 0, 11}}) {
    book.Add(permit);
  }
  EXPECT_EQ(book.Take(0).size(), 4);
}

// A permit that lapsed before a loop took it: another actor plays it.
TEST(PermitBook, APermitReleasedBeforeItWasTakenIsNotPlayed) {
  PermitBook book(1);
  book.Add(Permit(0));
  book.Add(Permit(1));
  book.Release(Permit(0));
  EXPECT_THAT(book.Take(0), ElementsAre(Permit(1)));
}

int64_t StepsOf(const PermitBook& book, const HeldPermit& permit) {
  for (const PermitProgress& progress : book.Progress()) {
    if (progress.permit == permit) return progress.steps;
  }
  return -1;
}

TEST(PermitBook, TellsHowFarFragmentsAre) {
  PermitBook book(2);
  for (int lane = 0; lane < 3; ++lane) book.Add(Permit(lane));
  book.Take(0);  // lanes 0 and 2
  book.SetSteps(0, 5);
  EXPECT_EQ(StepsOf(book, Permit(0)), 5);
  EXPECT_EQ(StepsOf(book, Permit(1)), 0) << "nobody plays it yet";
  EXPECT_EQ(StepsOf(book, Permit(2)), 5);
  book.SetSteps(0, 8);
  book.Release(Permit(2));
  book.Add(Permit(2, 1));
  book.Take(0);
  book.SetSteps(0, 3);
  EXPECT_EQ(StepsOf(book, Permit(0)), 8) << "played, but not answered for";
  EXPECT_EQ(StepsOf(book, Permit(2)), -1);
  EXPECT_EQ(StepsOf(book, Permit(2, 1)), 3);
}

TEST(PermitBook, FailuresAreToldOnce) {
  PermitBook book(1);
  book.Add(Permit(3));
  book.Take(0);
  book.Fail(Permit(3), "no game");
  EXPECT_THAT(book.Active(), IsEmpty());
  const std::vector<FailedPermit> failures = book.Failures(1);
  ASSERT_EQ(failures.size(), 1u);
  EXPECT_EQ(failures[0].permit, Permit(3));
  EXPECT_EQ(failures[0].reason, "no game");
  EXPECT_EQ(book.Failures(1).size(), 1u) << "the request may not have arrived";
  book.Told(failures);
  EXPECT_EQ(book.Failures(1).size(), 0u);
  book.Fail(Permit(3), "no game");
  EXPECT_EQ(book.Failures(2).size(), 0u) << "of another start of the learner";
  EXPECT_EQ(book.Failures(1).size(), 0u);
}

TEST(PermitBook, DropWaitingLeavesWhatIsBeingPlayed) {
  PermitBook book(1);
  book.Add(Permit(0));
  book.Take(0);
  book.Add(Permit(1));
  book.DropWaiting();
  EXPECT_THAT(book.Active(), ElementsAre(Permit(0)));
  book.Add(Permit(2));
  EXPECT_THAT(book.Take(0), ElementsAre(Permit(2)));
}

TEST(PermitBook, CloseWakesEveryLoop) {
  PermitBook book(3);
  std::vector<std::thread> loops;
  loops.reserve(3);
  for (int loop = 0; loop < 3; ++loop) {
    loops.emplace_back([&book, loop] { EXPECT_THAT(book.Take(loop), IsEmpty()); });
  }
  std::thread pausing([&book] { book.WaitForClose(absl::InfiniteDuration()); });
  book.Close();
  for (std::thread& loop : loops) loop.join();
  pausing.join();
  book.Add(Permit(0));
  EXPECT_THAT(book.Take(0), IsEmpty());
}

TEST(PermitBook, HandsEachPermitToOneLoopBetweenThreads) {
  constexpr int kLoops = 4;
  constexpr int kLanes = 64;
  constexpr int64_t kFragments = 50;
  PermitBook book(kLoops);
  book.SetTile(2);
  std::vector<std::set<HeldPermit>> played(kLoops);
  std::vector<std::thread> loops;
  loops.reserve(kLoops);
  for (int loop = 0; loop < kLoops; ++loop) {
    loops.emplace_back([&book, &mine = played[loop], loop] {
      for (auto permits = book.Take(loop); !permits.empty(); permits = book.Take(loop)) {
        for (const HeldPermit& permit : permits) {
          EXPECT_TRUE(mine.insert(permit).second);
          book.Release(permit);
        }
      }
    });
  }
  for (int64_t fragment = 0; fragment < kFragments; ++fragment) {
    for (int lane = 0; lane < kLanes; ++lane) book.Add(Permit(lane, fragment));
  }
  while (!book.Active().empty()) book.WaitForClose(absl::Milliseconds(1));
  book.Close();
  for (std::thread& loop : loops) loop.join();
  for (int loop = 0; loop < kLoops; ++loop) {
    EXPECT_EQ(played[loop].size(), kLanes / kLoops * kFragments);
    for (const HeldPermit& permit : played[loop]) EXPECT_EQ(permit.lane / 2 % kLoops, loop);
  }
}

}  // namespace
}  // namespace craftfleet
