// Backups: after permits have lapsed, a second actor plays old fragments, so that an iteration can finish.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/test_registry.h"

namespace craftfleet {
namespace {

using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneScheduler::Verdict;

constexpr int64_t kVersion = 3;

// Actors "a" and "b" on four lanes. Permits of the actor "dead" have lapsed, unless a test does otherwise.
class BackupTest : public testing::Test {
 protected:
  TestRegistry::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}, int capacity = 100) {
    const auto grant = registry_.GetPermits(actor, active, capacity, absl::ZeroDuration());
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(TestRegistry::Grant());
  }
  Verdict Push(const std::string& actor, const Permit& permit) {
    return registry_.Accept(actor, permit, {"after", {}}).value_or(Verdict::kExpired);
  }
  // "dead" gets a lane and is lost; then "a" and "b" have two lanes each.
  void LoseOne() {
    registry_.Join("dead", "");
    ASSERT_THAT(Ask("dead", {}, 1).granted, SizeIs(1));
    registry_.OnConnectionLost("dead");
    clock_.Advance(absl::Milliseconds(2001));
    Enter();
  }
  void Enter() {
    for (const char* name : {"a", "b"}) registry_.Join(name, "");
    of_a_ = Ask("a").granted;
    of_b_ = Ask("b").granted;
    ASSERT_THAT(of_a_, SizeIs(2));
    ASSERT_THAT(of_b_, SizeIs(2));
  }
  // "a" plays all of its fragments and waits for more.
  void FinishA() {
    for (const Permit& permit : of_a_) ASSERT_EQ(Push("a", permit), Verdict::kAccepted);
    clock_.Advance(absl::Milliseconds(1001));
  }
  // "a" is done and also plays the fragments of "b".
  void PlayTwice() {
    LoseOne();
    FinishA();
    ASSERT_EQ(Ask("a").granted, of_b_);
  }

  FakeClock clock_;
  TestRegistry registry_{
      {4, absl::Seconds(5), absl::Seconds(1), absl::Seconds(2)}, std::vector<LaneRecord>(4), &clock_};
  std::vector<Permit> of_a_, of_b_;

  void SetUp() override { registry_.OpenIteration(1, kVersion); }
};

TEST_F(BackupTest, NoBackupsBeforeAPermitLapses) {
  Enter();
  FinishA();
  EXPECT_THAT(Ask("a").granted, IsEmpty());
}

TEST_F(BackupTest, AnIdleActorBacksUpOldPermits) {
  LoseOne();
  for (const Permit& permit : of_a_) ASSERT_EQ(Push("a", permit), Verdict::kAccepted);
  EXPECT_THAT(Ask("a").granted, IsEmpty()) << "b has only just got them";
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_EQ(Ask("a").granted, of_b_);
  EXPECT_THAT(Ask("b", of_b_).lost, IsEmpty());
  EXPECT_EQ(Push("a", of_b_[0]), Verdict::kAccepted) << "the first result counts";
  EXPECT_EQ(Push("b", of_b_[0]), Verdict::kDuplicate);
  EXPECT_EQ(Push("b", of_b_[1]), Verdict::kAccepted);
  EXPECT_EQ(Push("a", of_b_[1]), Verdict::kDuplicate);
  EXPECT_EQ(registry_.permits(), 0);
}

TEST_F(BackupTest, AFragmentHasAtMostOneBackup) {
  PlayTwice();
  registry_.Join("c", "");
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(Ask("c").granted, IsEmpty());
}

TEST_F(BackupTest, ABusyActorGetsNoBackups) {
  LoseOne();
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(Ask("a", of_a_).granted, IsEmpty());
}

TEST_F(BackupTest, WhenOnePlayerIsLostTheOtherContinues) {
  PlayTwice();
  registry_.Leave("b");
  EXPECT_THAT(Ask("a", of_b_).lost, IsEmpty());
  EXPECT_EQ(registry_.permits(), 2);
  for (const Permit& permit : of_b_) EXPECT_EQ(Push("a", permit), Verdict::kAccepted);
}

TEST_F(BackupTest, ALostBackupCanBeReplaced) {
  PlayTwice();
  registry_.Leave("a");
  EXPECT_EQ(registry_.permits(), 2);
  registry_.Join("c", "");
  EXPECT_EQ(Ask("c").granted, of_b_);
}

TEST_F(BackupTest, TheHolderKeepsAPermitThatTheBackupReturns) {
  PlayTwice();
  Ask("a", {of_b_[1]});
  EXPECT_EQ(Push("a", of_b_[0]), Verdict::kExpired);
  EXPECT_EQ(Push("b", of_b_[0]), Verdict::kAccepted);
}

TEST_F(BackupTest, TheBackupKeepsAPermitThatTheHolderReturns) {
  PlayTwice();
  Ask("b", {});
  EXPECT_THAT(Ask("a", of_b_).lost, IsEmpty());
  EXPECT_EQ(Push("b", of_b_[0]), Verdict::kExpired);
  EXPECT_EQ(Push("a", of_b_[0]), Verdict::kAccepted);
}

TEST_F(BackupTest, TheNextIterationStartsWithoutBackups) {
  PlayTwice();
  for (const Permit& permit : of_b_) ASSERT_EQ(Push("b", permit), Verdict::kAccepted);
  registry_.OpenIteration(2, kVersion + 1);
  EXPECT_THAT(Ask("a").granted, SizeIs(2));
  const std::vector<Permit> of_b = Ask("b").granted;
  ASSERT_THAT(of_b, SizeIs(2));
  for (const Permit& permit : of_b) ASSERT_EQ(Push("b", permit), Verdict::kAccepted);
  clock_.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(Ask("b").granted, IsEmpty()) << "nothing has lapsed since";
}

}  // namespace
}  // namespace craftfleet
