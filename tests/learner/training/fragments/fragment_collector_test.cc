#include "learner/training/fragments/fragment_collector.h"

#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace fragment_collector_test {

using testing::ElementsAre;
using testing::Pair;

constexpr int kLanes = 2;
constexpr int64_t kPerLane = 2;  // fragments per iteration
constexpr int64_t kVersion = 5;

absl::Status Continue(size_t /*collected*/, bool /*is_idle*/) { return absl::OkStatus(); }

class FragmentCollectorTest : public testing::Test {
 protected:
  FragmentCollector Make() {
    registry_.Join("a", "");
    return FragmentCollector({&registry_, &queue_, &clock_});
  }
  static Fragment Played(int lane, int64_t number, uint64_t digest = 1) {
    Fragment fragment = SampleFragment(lane, number, kVersion);
    fragment.digest = digest;
    return fragment;
  }
  // Like the learner's service: the scheduler decides, then the fragment is queued.
  void Send(const Fragment& fragment) {
    const Permit permit = {fragment.lane, fragment.number, fragment.policy_version};
    registry_.GetPermits("a", {}, kLanes, absl::ZeroDuration()).IgnoreError();
    ASSERT_EQ(*registry_.Accept("a", permit, fragment.snapshot, fragment.digest), LaneScheduler::Verdict::kAccepted);
    ASSERT_THAT(queue_.Push(fragment), IsOk());
  }
  static std::vector<std::pair<int, int64_t>> Names(const std::vector<Fragment>& fragments) {
    std::vector<std::pair<int, int64_t>> names;
    for (const Fragment& fragment : fragments) names.emplace_back(fragment.lane, fragment.number);
    return names;
  }

  FakeClock clock_;
  TestRegistry registry_{{kLanes}, std::vector<LaneRecord>(kLanes), &clock_};
  FragmentQueue queue_{16};
};

TEST_F(FragmentCollectorTest, ReturnsTheIterationsFragmentsByLaneAndNumber) {
  FragmentCollector collector = Make();
  registry_.OpenIteration(kPerLane, kVersion);
  for (const auto& [lane, number] : std::vector<std::pair<int, int>>{{1, 0}, {0, 0}, {1, 1}, {0, 1}}) {
    Send(Played(lane, number));
  }
  const auto fragments = collector.Collect(kLanes * kPerLane, Continue);
  ASSERT_THAT(fragments, IsOk());
  EXPECT_THAT(Names(*fragments), ElementsAre(Pair(0, 0), Pair(0, 1), Pair(1, 0), Pair(1, 1)));
}

TEST_F(FragmentCollectorTest, ReportsProgressAndIdleTime) {
  FragmentCollector collector = Make();
  registry_.OpenIteration(kPerLane, kVersion);
  Send(Played(0, 0));
  std::vector<std::pair<size_t, bool>> ticks;
  EXPECT_THAT(collector.Collect(kLanes * kPerLane,
                                [&](size_t collected, bool is_idle) -> absl::Status {
                                  ticks.emplace_back(collected, is_idle);
                                  return is_idle ? absl::CancelledError("stopping") : absl::OkStatus();
                                }),
              StatusIs(absl::StatusCode::kCancelled, "stopping"));
  EXPECT_THAT(ticks, ElementsAre(Pair(1, false), Pair(1, true)));
}

TEST_F(FragmentCollectorTest, DropsFragmentsThatNoLongerCount) {
  FragmentCollector collector = Make();
  registry_.OpenIteration(kPerLane, kVersion);
  Send(Played(0, 0));
  ASSERT_THAT(queue_.Push(Played(0, 0, /*digest=*/2)), IsOk());  // its content differs from the accepted one
  Send(Played(0, 1));
  Send(Played(1, 0));
  Send(Played(1, 1));
  const auto fragments = collector.Collect(kLanes * kPerLane, Continue);
  ASSERT_THAT(fragments, IsOk());
  EXPECT_EQ(fragments->size(), 4u);
  EXPECT_EQ(fragments->front().digest, 1u);
}

// With asynchronous play.
class AsyncCollectorTest : public FragmentCollectorTest {
 protected:
  AsyncCollectorTest() { async_.Join("a", ""); }
  FragmentCollector MakeAsync() { return FragmentCollector({&async_, &queue_, &clock_}); }
  // The learner accepts it, but it is not in the queue yet.
  Fragment Accepted(int lane, int64_t number) {
    async_.GetPermits("a", {}, 1, absl::ZeroDuration()).IgnoreError();
    Fragment fragment = Played(lane, number, /*digest=*/100 + number);
    const Permit permit = {lane, number, kVersion};
    EXPECT_EQ(*async_.Accept("a", permit, fragment.snapshot, fragment.digest), LaneScheduler::Verdict::kAccepted);
    return fragment;
  }
  static LaneScheduler::Options Options() {
    LaneScheduler::Options options;
    options.lanes = kLanes;
    options.max_staleness = 1;
    options.rollout_fragments = 2;
    return options;
  }

  TestRegistry async_{Options(), std::vector<LaneRecord>(kLanes), &clock_};
};

TEST_F(AsyncCollectorTest, ReturnsTheFragmentsAcceptedFirstInWhateverOrderTheyAreQueued) {
  FragmentCollector collector = MakeAsync();
  async_.PublishVersion(kVersion);
  std::vector<Fragment> accepted;
  for (int number = 0; number < 4; ++number) accepted.push_back(Accepted(0, number));
  for (const int number : {2, 3, 1, 0}) ASSERT_THAT(queue_.Push(accepted[number]), IsOk());
  auto fragments = collector.CollectRollout(2, Continue);
  ASSERT_THAT(fragments, IsOk());
  EXPECT_THAT(Names(*fragments), ElementsAre(Pair(0, 0), Pair(0, 1)));
  async_.PublishVersion(kVersion + 1);
  fragments = collector.CollectRollout(2, Continue);
  ASSERT_THAT(fragments, IsOk());
  EXPECT_THAT(Names(*fragments), ElementsAre(Pair(0, 2), Pair(0, 3))) << "collected before their update";
}

TEST_F(AsyncCollectorTest, AfterAnUndoneUpdateNothingThatWasCollectedCounts) {
  FragmentCollector collector = MakeAsync();
  async_.PublishVersion(kVersion);
  for (int number = 0; number < 3; ++number) ASSERT_THAT(queue_.Push(Accepted(0, number)), IsOk());
  ASSERT_THAT(collector.CollectRollout(2, Continue), IsOk());
  async_.RewindIterations(2);
  async_.PublishVersion(kVersion);
  EXPECT_THAT(collector.CollectRollout(2,
                                       [](size_t collected, bool is_idle) -> absl::Status {
                                         EXPECT_EQ(collected, 0U);
                                         return is_idle ? absl::CancelledError("stopping") : absl::OkStatus();
                                       }),
              StatusIs(absl::StatusCode::kCancelled, "stopping"));
}

}  // namespace fragment_collector_test
}  // namespace craftfleet
