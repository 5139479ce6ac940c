#include "actor/permit_tracker.h"

#include <set>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

HeldPermit Held(int lane, int64_t fragment = 0) { return {{lane, fragment, 10}, 1}; }

TEST(PermitTracker, UsesSomeLoopsOnly) {
  PermitTracker tracker(3);
  tracker.Distribute(/*tile=*/2, /*loops=*/2);
  for (int lane = 0; lane < 8; ++lane) tracker.Add({{lane, 0, 0}, 1});
  EXPECT_EQ(tracker.Take(0).size(), 4U);  // lanes 0, 1, 4 and 5
  EXPECT_EQ(tracker.Take(1).size(), 4U);
}

TEST(PermitTracker, LanesOfOneTileGoToOneLoop) {
  PermitTracker tracker(2);
  tracker.Distribute(/*tile=*/4, /*loops=*/2);
  for (int lane = 0; lane < 16; ++lane) tracker.Add(Held(lane));
  std::vector<int> lanes[2];
  for (int loop = 0; loop < 2; ++loop) {
    for (const HeldPermit& permit : tracker.Take(loop)) lanes[loop].push_back(permit.lane);
  }
  EXPECT_THAT(lanes[0], ElementsAre(0, 1, 2, 3, 8, 9, 10, 11));
  EXPECT_THAT(lanes[1], ElementsAre(4, 5, 6, 7, 12, 13, 14, 15));
}

// A call of the policy has one version of the weights. With asynchronous play, permits with several wait.
TEST(PermitTracker, PermitsAreTakenVersionByVersionTheOldestFirst) {
  PermitTracker tracker(1);
  const HeldPermit newer = {{0, 5, 11}, 1}, old = {{1, 4, 10}, 1}, also_newer = {{2, 5, 11}, 1},
                   restarted = {{3, 5, 9}, 2};
  for (const HeldPermit& permit : {newer, restarted, old, also_newer}) tracker.Add(permit);
  EXPECT_THAT(tracker.Take(0), ElementsAre(old));
  EXPECT_THAT(tracker.Take(0), ElementsAre(newer, also_newer));
  EXPECT_THAT(tracker.Take(0), ElementsAre(restarted));
}

TEST(PermitTracker, APermitGrantedTwiceIsPlayedOnce) {
  PermitTracker tracker(1);
  tracker.Add(Held(3));
  tracker.Add(Held(3));
  EXPECT_THAT(tracker.Take(0), ElementsAre(Held(3)));
  tracker.Add(Held(3));  // is being played
  tracker.Add(Held(4));
  EXPECT_THAT(tracker.Take(0), ElementsAre(Held(4)));
}

TEST(PermitTracker, APermitIsHeldUntilItIsReleased) {
  PermitTracker tracker(1);
  tracker.Add(Held(0));
  tracker.Add(Held(1));
  EXPECT_THAT(tracker.Active(), ElementsAre(Held(0), Held(1)));
  tracker.Take(0);
  EXPECT_THAT(tracker.Active(), ElementsAre(Held(0), Held(1)));
  tracker.Release(Held(0));
  tracker.Release(Held(7));
  EXPECT_THAT(tracker.Active(), ElementsAre(Held(1)));
  tracker.Add(Held(0));  // granted again after it was released
  EXPECT_THAT(tracker.Take(0), ElementsAre(Held(0)));
}

TEST(PermitTracker, FragmentEpochAndVersionDistinguishPermits) {
  PermitTracker tracker(1);
  for (const HeldPermit& permit :
       {HeldPermit{{0, 0, 10}, 1}, HeldPermit{{0, 1, 10}, 1}, HeldPermit{{0, 0, 10}, 2}, HeldPermit{{0, 0, 11}, 1}}) {
    tracker.Add(permit);
  }
  EXPECT_EQ(tracker.Active().size(), 4);
}

// A permit that lapsed before a loop took it: another actor plays it.
TEST(PermitTracker, APermitReleasedBeforeItWasTakenIsNotPlayed) {
  PermitTracker tracker(1);
  tracker.Add(Held(0));
  tracker.Add(Held(1));
  tracker.Release(Held(0));
  EXPECT_THAT(tracker.Take(0), ElementsAre(Held(1)));
}

TEST(PermitTracker, FailuresAreReportedOnce) {
  PermitTracker tracker(1);
  tracker.Add(Held(3));
  tracker.Take(0);
  tracker.Fail(Held(3), "no game");
  EXPECT_THAT(tracker.Active(), IsEmpty());
  const std::vector<HeldPermit> failures = tracker.Failures(1);
  ASSERT_EQ(failures.size(), 1u);
  EXPECT_EQ(failures[0], Held(3));
  EXPECT_EQ(failures[0].failure, "no game");
  EXPECT_EQ(tracker.Failures(1).size(), 1u) << "the request may not have arrived";
  tracker.SetReported(failures);
  EXPECT_EQ(tracker.Failures(1).size(), 0u);
  tracker.Fail(Held(3), "no game");
  EXPECT_EQ(tracker.Failures(2).size(), 0u) << "from another start of the learner";
  EXPECT_EQ(tracker.Failures(1).size(), 0u);
}

TEST(PermitTracker, DropWaitingKeepsPermitsBeingPlayed) {
  PermitTracker tracker(1);
  tracker.Add(Held(0));
  tracker.Take(0);
  tracker.Add(Held(1));
  tracker.DropWaiting();
  EXPECT_THAT(tracker.Active(), ElementsAre(Held(0)));
  tracker.Add(Held(2));
  EXPECT_THAT(tracker.Take(0), ElementsAre(Held(2)));
}

TEST(PermitTracker, TakeWaitsNoLongerThanItsTimeout) {
  PermitTracker tracker(1);
  EXPECT_THAT(tracker.Take(0, absl::Milliseconds(1)), IsEmpty());
  EXPECT_FALSE(tracker.closed());
  tracker.Close();
  EXPECT_TRUE(tracker.closed());
}

TEST(PermitTracker, CloseWakesEveryLoop) {
  PermitTracker tracker(3);
  std::vector<std::thread> loops;
  loops.reserve(3);
  for (int loop = 0; loop < 3; ++loop) {
    loops.emplace_back([&tracker, loop] { EXPECT_THAT(tracker.Take(loop), IsEmpty()); });
  }
  std::thread pausing([&tracker] { tracker.WaitForClose(absl::InfiniteDuration()); });
  tracker.Close();
  for (std::thread& loop : loops) loop.join();
  pausing.join();
  tracker.Add(Held(0));
  EXPECT_THAT(tracker.Take(0), IsEmpty());
}

TEST(PermitTracker, GivesEachPermitToOneLoopAcrossThreads) {
  constexpr int kLoops = 4;
  constexpr int kLanes = 64;
  constexpr int64_t kFragments = 50;
  PermitTracker tracker(kLoops);
  tracker.Distribute(/*tile=*/2, kLoops);
  std::vector<std::set<HeldPermit>> played(kLoops);
  std::vector<std::thread> loops;
  loops.reserve(kLoops);
  for (int loop = 0; loop < kLoops; ++loop) {
    loops.emplace_back([&tracker, &mine = played[loop], loop] {
      for (auto permits = tracker.Take(loop); !permits.empty(); permits = tracker.Take(loop)) {
        for (const HeldPermit& permit : permits) {
          EXPECT_TRUE(mine.insert(permit).second);
          tracker.Release(permit);
        }
      }
    });
  }
  for (int64_t fragment = 0; fragment < kFragments; ++fragment) {
    for (int lane = 0; lane < kLanes; ++lane) tracker.Add(Held(lane, fragment));
  }
  while (!tracker.Active().empty()) tracker.WaitForClose(absl::Milliseconds(1));
  tracker.Close();
  for (std::thread& loop : loops) loop.join();
  for (int loop = 0; loop < kLoops; ++loop) {
    EXPECT_EQ(played[loop].size(), kLanes / kLoops * kFragments);
    for (const HeldPermit& permit : played[loop]) EXPECT_EQ(permit.lane / 2 % kLoops, loop);
  }
}

}  // namespace
}  // namespace craftfleet
