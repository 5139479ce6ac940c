// A fragment that two actors play: where permits lapse, the end of an iteration does not wait for one of them alone.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/lane_ledger.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneLedger::Verdict;

constexpr int64_t kVersion = 3;

// Actors "a" and "b" on four lanes; "dead" had permits that lapsed, unless a test says otherwise.
class BackupTest : public testing::Test {
 protected:
  LaneLedger::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}, int capacity = 100) {
    const auto grant = ledger_.GetPermits(actor, active, capacity, absl::ZeroDuration());
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(LaneLedger::Grant());
  }
  Verdict Push(const std::string& actor, const Permit& permit) {
    return ledger_.Accept(actor, permit, {"after", {}}).value_or(Verdict::kExpired);
  }
  // "dead" takes a lane and is gone; then "a" and "b" have two lanes each.
  void LoseOne() {
    ledger_.Join("dead", "");
    ASSERT_THAT(Ask("dead", {}, 1).granted, SizeIs(1));
    ledger_.LoseTouch("dead");
    clock_.Advance(absl::Milliseconds(2001));
    Enter();
  }
  void Enter() {
    for (const char* name : {"a", "b"}) ledger_.Join(name, "");
    of_a_ = Ask("a").granted;
    of_b_ = Ask("b").granted;
    ASSERT_THAT(of_a_, SizeIs(2));
    ASSERT_THAT(of_b_, SizeIs(2));
  }
  // "a" has played all of its own and waited for more.
  void FinishA() {
    for (const Permit& permit : of_a_) ASSERT_EQ(Push("a", permit), Verdict::kAccepted);
    clock_.Advance(absl::Milliseconds(1001));
  }
  // "a" is done and also plays what "b" has.
  void PlayTwice() {
    LoseOne();
    FinishA();
    ASSERT_EQ(Ask("a").granted, of_b_);
  }

  FakeClock clock_;
  LaneLedger ledger_{{4, absl::Seconds(5), absl::Seconds(1), absl::Seconds(2)}, std::vector<LaneRecord>(4), &clock_};
  std::vector<Permit> of_a_, of_b_;

  void SetUp() override { ledger_.OpenIteration(1, kVersion); }
};

TEST_F(BackupTest, NobodyPlaysWhatAnotherPlaysWhileNothingLapsed) {
  Enter();
  FinishA();
  EXPECT_THAT(Ask("a").granted, IsEmpty());
}

TEST_F(BackupTest, AnIdleActorAlsoPlaysWhatAnotherHasHadForAWhile) {
  LoseOne();
  for (const Permit& permit : of_a_) ASSERT_EQ(Push("a", permit), Verdict::kAccepted);
  EXPECT_THAT(Ask("a").granted, IsEmpty()) << "the other has only just got it";
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_EQ(Ask("a").granted, of_b_);
  EXPECT_THAT(Ask("b", of_b_).lost, IsEmpty());
  EXPECT_EQ(Push("a", of_b_[0]), Verdict::kAccepted) << "who is first counts";
  EXPECT_EQ(Push("b", of_b_[0]), Verdict::kDuplicate);
  EXPECT_EQ(Push("b", of_b_[1]), Verdict::kAccepted);
  EXPECT_EQ(Push("a", of_b_[1]), Verdict::kDuplicate);
  EXPECT_EQ(ledger_.permits(), 0);
}

TEST_F(BackupTest, NoThirdPlaysIt) {
  PlayTwice();
  ledger_.Join("c", "");
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(Ask("c").granted, IsEmpty());
}

TEST_F(BackupTest, WhoIsBusyPlaysNothingTwice) {
  LoseOne();
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(Ask("a", of_a_).granted, IsEmpty());
}

TEST_F(BackupTest, WhenOneOfTheTwoIsGoneTheOtherGoesOn) {
  PlayTwice();
  ledger_.Leave("b");
  EXPECT_THAT(Ask("a", of_b_).lost, IsEmpty());
  EXPECT_EQ(ledger_.permits(), 2);
  for (const Permit& permit : of_b_) EXPECT_EQ(Push("a", permit), Verdict::kAccepted);
}

TEST_F(BackupTest, WhenTheBackupIsGoneAnotherMayBeIt) {
  PlayTwice();
  ledger_.Leave("a");
  EXPECT_EQ(ledger_.permits(), 2);
  ledger_.Join("c", "");
  EXPECT_EQ(Ask("c").granted, of_b_);
}

TEST_F(BackupTest, WhatTheBackupGivesBackTheHolderKeeps) {
  PlayTwice();
  Ask("a", {of_b_[1]});
  EXPECT_EQ(Push("a", of_b_[0]), Verdict::kExpired);
  EXPECT_EQ(Push("b", of_b_[0]), Verdict::kAccepted);
}

TEST_F(BackupTest, WhatTheHolderGivesBackTheBackupKeeps) {
  PlayTwice();
  Ask("b", {});
  EXPECT_THAT(Ask("a", of_b_).lost, IsEmpty());
  EXPECT_EQ(Push("b", of_b_[0]), Verdict::kExpired);
  EXPECT_EQ(Push("a", of_b_[0]), Verdict::kAccepted);
}

TEST_F(BackupTest, TheNextIterationBeginsAnew) {
  PlayTwice();
  for (const Permit& permit : of_b_) ASSERT_EQ(Push("b", permit), Verdict::kAccepted);
  ledger_.OpenIteration(2, kVersion + 1);
  EXPECT_THAT(Ask("a").granted, SizeIs(2));
  const std::vector<Permit> of_b = Ask("b").granted;
  ASSERT_THAT(of_b, SizeIs(2));
  for (const Permit& permit : of_b) ASSERT_EQ(Push("b", permit), Verdict::kAccepted);
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(Ask("b").granted, IsEmpty()) << "nothing has lapsed since";
}

}  // namespace
}  // namespace craftfleet
