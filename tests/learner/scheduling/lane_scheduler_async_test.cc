// Asynchronous play: which update a fragment is for, which ones are too old, and how far play runs ahead. Thousands of
// random histories are checked against a plain model.
#include <algorithm>
#include <cstdint>
#include <deque>
#include <map>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;
using Verdict = LaneScheduler::Verdict;

LaneScheduler::Options AsyncOptions(int lanes, int max_staleness, int64_t rollout_fragments) {
  LaneScheduler::Options options;
  options.lanes = lanes;
  options.max_staleness = max_staleness;
  options.rollout_fragments = rollout_fragments;
  return options;
}

// Of a fragment as any actor would play it.
uint64_t Digest(const Permit& permit) {
  return static_cast<uint64_t>(permit.fragment * 10000 + permit.policy_version * 10 + permit.lane);
}

// Two lanes, two fragments to an update.
class AsyncLanes : public testing::Test {
 protected:
  std::vector<Permit> Ask(const std::string& actor, const std::vector<Permit>& active = {}, int capacity = 1) {
    return registry_.GetPermits(actor, active, capacity, absl::ZeroDuration())->granted;
  }
  std::vector<Permit> Enter(const std::string& actor) {
    registry_.Join(actor, "");
    return Ask(actor);
  }
  Verdict Push(const std::string& actor, const Permit& permit) {
    return registry_.Accept(actor, permit, {absl::StrCat("after ", permit.fragment), {}}, Digest(permit)).value();
  }
  // "a" plays three fragments of the first lane, of which the rollout takes two.
  void TakeARolloutAndOneFragmentMore() {
    registry_.PublishVersion(0);
    registry_.Join("a", "");
    for (int i = 0; i < 3; ++i) {
      ASSERT_FALSE(Ask("a").empty());
      ASSERT_EQ(Push("a", {0, i, 0}), Verdict::kAccepted);
    }
    ASSERT_TRUE(registry_.TakeRollout().has_value());
  }
  static Arrival Of(const Permit& permit) { return {permit, Digest(permit)}; }

  FakeClock clock_;
  TestRegistry registry_{AsyncOptions(2, 1, 2), std::vector<LaneRecord>(2), &clock_};
};

TEST_F(AsyncLanes, ALaneGoesOnAsSoonAsItsFragmentIsIn) {
  registry_.PublishVersion(0);
  EXPECT_THAT(Enter("fast"), ElementsAre(Permit{0, 0, 0}));
  EXPECT_THAT(Enter("slow"), ElementsAre(Permit{1, 0, 0}));
  EXPECT_EQ(Push("fast", {0, 0, 0}), Verdict::kAccepted);
  EXPECT_FALSE(registry_.TakeRollout().has_value());
  EXPECT_THAT(Ask("fast"), ElementsAre(Permit{0, 1, 0})) << "although the other lane is not done";
  EXPECT_EQ(Push("fast", {0, 1, 0}), Verdict::kAccepted);
  EXPECT_THAT(registry_.TakeRollout().value(), ElementsAre(Of({0, 0, 0}), Of({0, 1, 0})));
  EXPECT_THAT(Ask("fast"), ElementsAre(Permit{0, 2, 0})) << "while the update runs";
  registry_.PublishVersion(1);
  EXPECT_EQ(Push("fast", {0, 2, 0}), Verdict::kAccepted);
  EXPECT_THAT(Ask("fast"), ElementsAre(Permit{0, 3, 1})) << "with the newest weights";
}

TEST_F(AsyncLanes, AFragmentThatWouldBeTooOldIsDroppedAndPlayedAgain) {
  registry_.PublishVersion(0);
  Enter("fast");
  Enter("slow");
  for (int update = 0; update < 2; ++update) {
    for (int i = 0; i < 2; ++i) {
      ASSERT_EQ(Push("fast", {0, 2 * update + i, update}), Verdict::kAccepted);
      if (i == 1) {
        ASSERT_TRUE(registry_.TakeRollout().has_value());
        registry_.PublishVersion(update + 1);
      }
      ASSERT_THAT(Ask("fast"), SizeIs(1));
    }
  }
  testing::internal::CaptureStderr();
  EXPECT_EQ(Push("slow", {1, 0, 0}), Verdict::kStale) << "two updates have started since";
  EXPECT_THAT(
      testing::internal::GetCapturedStderr(),
      HasSubstr("fragment 0 of lane 1 from actor slow is dropped and played again: its weights are 2 updates old, "
                "max_staleness is 1 (dropped so far, of all actors: 1)"));
  EXPECT_EQ(registry_.counters().dropped, 1);
  EXPECT_FALSE(registry_.Counts(1, 0, Digest({1, 0, 0})));
  EXPECT_THAT(Ask("slow"), ElementsAre(Permit{1, 0, 2})) << "the same fragment, with the newest weights";
  EXPECT_EQ(Push("slow", {1, 0, 0}), Verdict::kExpired) << "the old one, sent again";
  EXPECT_EQ(Push("slow", {1, 0, 2}), Verdict::kAccepted);
}

// An actor that was stopped for a while sends what another one has played since. Its fragment was reported as an error.
TEST_F(AsyncLanes, ALateFragmentWithOlderWeightsIsNotCompared) {
  registry_.PublishVersion(0);
  ASSERT_THAT(Enter("stopped"), ElementsAre(Permit{0, 0, 0}));
  ASSERT_THAT(Enter("other"), ElementsAre(Permit{1, 0, 0}));
  ASSERT_EQ(Push("other", {1, 0, 0}), Verdict::kAccepted);
  ASSERT_THAT(Ask("other"), ElementsAre(Permit{1, 1, 0}));
  ASSERT_EQ(Push("other", {1, 1, 0}), Verdict::kAccepted);
  ASSERT_TRUE(registry_.TakeRollout().has_value());
  registry_.PublishVersion(1);
  clock_.Advance(absl::Seconds(6));
  Ask("other", {}, 0);
  EXPECT_THAT(Ask("other", {}, 2), testing::Contains(Permit{0, 0, 1})) << "the permit has lapsed";
  EXPECT_EQ(Push("other", {0, 0, 1}), Verdict::kAccepted);
  registry_.Join("stopped", "");
  testing::internal::CaptureStderr();
  EXPECT_EQ(Push("stopped", {0, 0, 0}), Verdict::kDuplicate);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
  EXPECT_EQ(registry_.counters().differing, 0);
  const auto differing = registry_.Accept("stopped", {0, 0, 1}, {"after 0", {}}, Digest({0, 0, 1}) + 1);
  EXPECT_EQ(*differing, Verdict::kDuplicate);
  EXPECT_EQ(registry_.counters().differing, 1) << "with the same weights it is an error";
}

TEST_F(AsyncLanes, PlayRunsAheadNoFurtherThanDropsAreImpossible) {
  registry_.PublishVersion(0);
  registry_.Join("a", "");
  int64_t accepted = 0;
  std::vector<Permit> permits = Ask("a", {}, 2);
  while (!permits.empty()) {
    for (const Permit& permit : permits) {
      EXPECT_EQ(Push("a", permit), Verdict::kAccepted);
      ++accepted;
    }
    permits = Ask("a", {}, 2);
  }
  EXPECT_EQ(accepted, 4) << "rollouts for the update from these weights and for the one after";
  ASSERT_TRUE(registry_.TakeRollout().has_value());
  EXPECT_THAT(Ask("a", {}, 2), IsEmpty()) << "not before the update has ended";
  registry_.PublishVersion(1);
  EXPECT_THAT(Ask("a", {}, 2), ElementsAre(Permit{0, 2, 1}, Permit{1, 2, 1}));
}

TEST_F(AsyncLanes, ACheckpointHasTheLanesAfterTheFragmentsThatWereTaken) {
  ASSERT_NO_FATAL_FAILURE(TakeARolloutAndOneFragmentMore());
  const LaneRecord lane = registry_.StartRecords()[0];
  EXPECT_EQ(lane.next_fragment, 2);
  EXPECT_EQ(lane.snapshot->game, "after 1");
  EXPECT_EQ(lane.previous->game, "after 0");
  EXPECT_EQ(registry_.Records()[0].next_fragment, 3);
}

TEST_F(AsyncLanes, AnUndoneUpdateAndAllThatWasPlayedSinceArePlayedAgain) {
  ASSERT_NO_FATAL_FAILURE(TakeARolloutAndOneFragmentMore());
  registry_.RewindIterations(2);
  EXPECT_THAT(Ask("a"), IsEmpty());
  registry_.PublishVersion(0);
  EXPECT_THAT(Ask("a"), ElementsAre(Permit{0, 0, 0}));
  EXPECT_FALSE(registry_.TakeRollout().has_value());
}

// Actors that act randomly, a trainer that takes rollouts and publishes versions at random moments, and a model of what
// was accepted and learned.
class History {
 public:
  explicit History(int seed)
      : random_(seed),
        lanes_(1 + Below(5)),
        max_staleness_(1 + Below(2)),
        rollout_(lanes_ * (1 + Below(2))),
        learned_(lanes_),
        registry_(AsyncOptions(lanes_, max_staleness_, rollout_),
                  std::vector<LaneRecord>(lanes_, {0, {"new", {}}, {"older", {}}}), &clock_) {
    registry_.PublishVersion(version_);
  }

  void Run() {
    for (int step = 0; step < 300 && !testing::Test::HasFailure(); ++step) {
      Step();
      Settle();
    }
    if (!testing::Test::HasFailure()) PlayInOrder();
  }
  int64_t learned() const { return total_learned_; }
  int64_t dropped() const { return dropped_; }

 private:
  int Below(int n) { return static_cast<int>(random_() % n); }
  // The version from which the update that gets the queue's fragment `i` starts.
  int64_t UpdateOf(size_t i) const { return version_ + (is_updating_ ? 1 : 0) + static_cast<int64_t>(i) / rollout_; }

  void Step() {
    const std::string name = absl::StrCat("actor", Below(4));
    switch (Below(12)) {
      case 0:
        return registry_.Join(name, "");
      case 1:
        if (Below(8) == 0) registry_.Leave(name);
        return;
      case 2:
        return clock_.Advance(absl::Milliseconds(Below(Below(12) == 0 ? 30000 : 500)));
      case 3:
      case 4:
      case 5:
        return Train(/*failures=*/30);
      case 6:
      case 7:
        return Ask(name, Below(lanes_ + 2));
      default:
        return Push(name, Below(8) == 0);
    }
  }

  void Ask(const std::string& name, int capacity) {
    std::vector<Permit>& held = held_[name];
    WorkerRegistry::PermitRequest request = TestRegistry::RequestOf(name, held, capacity);
    if (!held.empty() && Below(10) == 0) {
      request.failures.push_back({held.back().lane, held.back().fragment, "no game"});
      request.active.pop_back();
      held.pop_back();
    }
    const auto reply = registry_.GetPermits(request);
    if (!reply.ok()) return held.clear();
    for (const Permit& permit : reply->granted) {
      ASSERT_LE(permit.policy_version, version_);
      held.push_back(permit);
    }
  }

  // An actor may also send a fragment whose permit it has lost, if `late`.
  void Push(const std::string& name, bool late) {
    std::vector<Permit>& held = held_[name];
    if (held.empty() || (name == "actor0" && Below(8) != 0)) return;  // which is slow
    const size_t i = Below(static_cast<int>(held.size()));
    const Permit permit = held[i];
    if (!late) held.erase(held.begin() + static_cast<int64_t>(i));
    const uint64_t digest = Digest(permit);
    const int64_t age = UpdateOf(queue_.size()) - permit.policy_version;
    const auto verdict = registry_.Accept(name, permit, {absl::StrCat("after ", permit.fragment), {}}, digest);
    ASSERT_THAT(verdict, IsOk());
    if (*verdict == Verdict::kAccepted) {
      ASSERT_LE(age, max_staleness_);
      queue_.push_back({permit, digest});
    } else if (*verdict == Verdict::kStale) {
      ASSERT_GT(age, max_staleness_) << "it would have been in time";
      ++dropped_;
    }
  }

  // Takes a rollout, or ends an update; one in `failures` of these fails, or none if that is 0.
  void Train(int failures) {
    if (is_updating_) {
      is_updating_ = false;
      if (failures > 0 && Below(failures) == 0) return Undo();
      ++version_;
      registry_.PublishVersion(version_);
      return;
    }
    const auto taken = registry_.TakeRollout();
    ASSERT_EQ(taken.has_value(), queue_.size() >= static_cast<size_t>(rollout_));
    if (!taken.has_value()) return;
    before_ = learned_;
    for (const Arrival& arrival : *taken) {
      const Permit& permit = arrival.permit;
      ASSERT_EQ(arrival, queue_.front()) << "the order of arrival";
      ASSERT_EQ(permit.fragment, learned_[permit.lane]++) << "each once and none left out";
      ASSERT_LE(version_ - permit.policy_version, max_staleness_);
      ASSERT_GE(version_, permit.policy_version);
      ASSERT_TRUE(registry_.Counts(permit.lane, permit.fragment, arrival.digest));
      queue_.pop_front();
      ++total_learned_;
    }
    is_updating_ = true;
    const std::vector<LaneRecord> starts = registry_.StartRecords();
    for (int lane = 0; lane < lanes_; ++lane) ASSERT_EQ(starts[lane].next_fragment, learned_[lane]);
  }

  void Undo() {
    registry_.RewindIterations(2);
    registry_.PublishVersion(version_);
    learned_ = before_;
    total_learned_ -= rollout_;
    queue_.clear();
  }

  // Forgets the fragments of lanes that were reset; checks that nothing else is gone.
  void Settle() {
    const std::vector<LaneRecord> records = registry_.Records();
    const size_t before = queue_.size();
    queue_.erase(std::remove_if(queue_.begin(), queue_.end(),
                                [&](const Arrival& arrival) {
                                  return arrival.permit.fragment >= records[arrival.permit.lane].next_fragment;
                                }),
                 queue_.end());
    if (queue_.size() != before) {
      ASSERT_GT(registry_.counters().resets, resets_) << "only a reset takes fragments away";
    }
    resets_ = registry_.counters().resets;
    std::vector<int64_t> next = learned_;
    for (const Arrival& arrival : queue_) ASSERT_EQ(arrival.permit.fragment, next[arrival.permit.lane]++);
    for (int lane = 0; lane < lanes_; ++lane) {
      ASSERT_EQ(records[lane].next_fragment, next[lane]) << "accepted, but neither learned from nor waiting";
    }
    ASSERT_EQ(registry_.counters().dropped, dropped_) << "all drops are counted";
    ASSERT_LE(queue_.size(), static_cast<size_t>((max_staleness_ + 1) * rollout_)) << "the learner's memory is bounded";
  }

  // An actor that plays its permits in order always gets work in time for the next update, and loses nothing.
  void PlayInOrder() {
    for (const auto& [name, permits] : held_) registry_.Leave(name);
    held_.clear();
    registry_.Join("good", "");
    const int64_t wanted = total_learned_ + 3 * rollout_;
    const int64_t dropped_before = dropped_;
    for (int i = 0; total_learned_ < wanted && !testing::Test::HasFailure(); ++i) {
      ASSERT_LT(i, 3000) << "training is stuck";
      std::vector<Permit>& held = held_["good"];
      const auto reply = registry_.GetPermits(TestRegistry::RequestOf("good", held, lanes_));
      ASSERT_THAT(reply, IsOk());
      held.insert(held.end(), reply->granted.begin(), reply->granted.end());
      if (!held.empty()) {
        const Permit permit = held.front();
        held.erase(held.begin());
        const uint64_t digest = Digest(permit);
        ASSERT_EQ(*registry_.Accept("good", permit, {"next", {}}, digest), Verdict::kAccepted);
        queue_.push_back({permit, digest});
      }
      if (held.empty() || Below(3) == 0) Train(/*failures=*/0);
      Settle();
      clock_.Advance(absl::Milliseconds(200));
    }
    ASSERT_EQ(dropped_, dropped_before);
  }

  std::mt19937 random_;
  mutable FakeClock clock_;
  const int lanes_;
  const int max_staleness_;
  const int64_t rollout_;
  std::deque<Arrival> queue_;     // accepted, not taken
  std::vector<int64_t> learned_;  // fragments of each lane
  std::vector<int64_t> before_;   // the same before the current update
  TestRegistry registry_;
  std::map<std::string, std::vector<Permit>> held_;
  int64_t version_ = 0;
  bool is_updating_ = false;
  int64_t total_learned_ = 0;
  int64_t dropped_ = 0;
  int64_t resets_ = 0;
};

TEST(AsyncLanesProperty, NothingTooOldIsLearnedFromNothingTwiceAndNothingIsLost) {
  int64_t learned = 0;
  int64_t dropped = 0;
  for (int seed = 0; seed < 3000; ++seed) {
    SCOPED_TRACE(seed);
    History history(seed);
    history.Run();
    if (HasFailure()) return;
    learned += history.learned();
    dropped += history.dropped();
  }
  EXPECT_GT(learned, 10000);
  EXPECT_GT(dropped, 100) << "the histories must also have drops";
}

}  // namespace
}  // namespace craftfleet
