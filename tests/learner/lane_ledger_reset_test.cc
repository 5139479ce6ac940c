// Lanes whose snapshot is no game are put back, and fragments that come twice are compared.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/lane_ledger.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneLedger::Verdict;

constexpr int64_t kVersion = 3;

// One lane whose iteration goes from fragment 6 up to 9; it began with the snapshots "before 5" and "before 6".
class ResetTest : public testing::Test {
 protected:
  void SetUp() override { ledger_.OpenIteration(9, kVersion); }

  std::vector<Permit> Ask(const std::string& actor, const std::vector<Permit>& active = {}) {
    return ledger_.GetPermits(actor, active, 1, absl::ZeroDuration()).value_or(LaneLedger::Grant()).granted;
  }
  // Takes the lane one further.
  void Play(const std::string& actor, int64_t fragment, uint64_t digest = 0) {
    ASSERT_THAT(Ask(actor), testing::ElementsAre(Permit{0, fragment, kVersion}));
    const auto verdict = ledger_.Accept(actor, {0, fragment, kVersion}, Before(fragment + 1), digest);
    ASSERT_EQ(verdict.value(), Verdict::kAccepted);
  }
  static LaneSnapshot Before(int64_t fragment) {
    return {"before " + std::to_string(fragment), {static_cast<float>(fragment)}};
  }
  // Takes the permit and gives it back.
  void Refuse(const std::string& actor, int64_t fragment) {
    ASSERT_THAT(Ask(actor), testing::ElementsAre(Permit{0, fragment, kVersion})) << actor;
    ledger_.Refuse(actor, 0, fragment, "bytes \x1b[2J");
  }
  int64_t Next() const { return ledger_.Records()[0].next_fragment; }

  FakeClock clock_;
  LaneLedger ledger_{{1}, {{6, Before(6), Before(5)}}, &clock_};
};

TEST_F(ResetTest, AnotherIsAskedBeforeALaneIsPutBack) {
  ledger_.Join("liar", "");
  ledger_.Join("a", "");
  ledger_.Join("b", "");
  Play("liar", 6);
  Play("liar", 7);
  ledger_.Leave("liar");
  Refuse("a", 8);
  EXPECT_THAT(Ask("a"), IsEmpty()) << "the other has the first choice";
  EXPECT_EQ(Next(), 8);
  testing::internal::CaptureStderr();
  Refuse("b", 8);
  EXPECT_EQ(Next(), 6) << "to the beginning of the iteration: what comes of it is the same";
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("lane 0: the snapshot after its fragment 7, from actor liar, is no game"),
                    HasSubstr("bytes ?[2J"), HasSubstr("played again from fragment 6 on")));
  EXPECT_EQ(ledger_.resets(), 1);
  EXPECT_EQ(ledger_.Snapshot(0, 6).value(), Before(6));
  for (int64_t fragment = 6; fragment < 9; ++fragment) Play("a", fragment);
  EXPECT_THAT(Ask("a"), IsEmpty());
}

TEST_F(ResetTest, WhatWasPutBackCountsNoMore) {
  ledger_.Join("liar", "");
  Play("liar", 6, 66);
  EXPECT_TRUE(ledger_.Counts(0, 6, 66));
  EXPECT_FALSE(ledger_.Counts(0, 6, 67));
  Refuse("liar", 7);
  Refuse("liar", 7);
  EXPECT_FALSE(ledger_.Counts(0, 6, 66));
  Play("liar", 6, 67);
  EXPECT_TRUE(ledger_.Counts(0, 6, 67));
}

TEST_F(ResetTest, OneRefusalByTheSameActorIsNotTwo) {
  ledger_.Join("a", "");
  ledger_.Join("b", "");
  Refuse("a", 6);
  clock_.Advance(absl::Seconds(5));
  EXPECT_THAT(Ask("b", {}), SizeIs(1));
  ASSERT_EQ(ledger_.Accept("b", {0, 6, kVersion}, Before(7)).value(), Verdict::kAccepted);
  EXPECT_EQ(ledger_.resets(), 0) << "b could play it";
  ledger_.Refuse("a", 0, 6, "late");
  ledger_.Refuse("stranger", 0, 7, "never asked");
  ledger_.Refuse("a", 17, 7, "no such lane");
  EXPECT_EQ(Next(), 7);
}

TEST_F(ResetTest, AtTheBeginningOfAnIterationTheLaneGoesOnFromItsPreviousSnapshot) {
  ledger_.Join("a", "");
  Refuse("a", 6);
  EXPECT_EQ(ledger_.resets(), 0);
  Refuse("a", 6);
  EXPECT_EQ(ledger_.resets(), 1);
  EXPECT_EQ(ledger_.Snapshot(0, 6).value(), Before(5)) << "the same fragment, from a game one fragment younger";
  // That one neither: a new game, which nobody can fail to restore.
  Refuse("a", 6);
  Refuse("a", 6);
  EXPECT_EQ(ledger_.Snapshot(0, 6).value(), (LaneSnapshot{"", {0}}));
  EXPECT_EQ(ledger_.resets(), 2);
  for (int i = 0; i < 5; ++i) Refuse("a", 6);
  EXPECT_EQ(ledger_.resets(), 2);
  Play("a", 6);
}

TEST_F(ResetTest, APutBackLaneIsRewoundToWhereItWasPutBackTo) {
  ledger_.Join("a", "");
  for (int i = 0; i < 2; ++i) Refuse("a", 6);
  Play("a", 6);
  ledger_.RewindIteration();
  EXPECT_EQ(ledger_.Snapshot(0, 6).value(), Before(5));
}

TEST_F(ResetTest, AnIterationIsRewound) {
  ledger_.Join("a", "");
  Play("a", 6, 66);
  Play("a", 7, 77);
  ledger_.RewindIteration();
  EXPECT_THAT(Ask("a"), IsEmpty()) << "until it is opened again";
  EXPECT_FALSE(ledger_.Counts(0, 7, 77));
  EXPECT_EQ(ledger_.Snapshot(0, 6).value(), Before(6));
  ledger_.OpenIteration(9, kVersion);
  for (int64_t fragment = 6; fragment < 9; ++fragment) Play("a", fragment);
}

TEST_F(ResetTest, WhatAnEarlierStartTookInIsRewoundToo) {
  LaneLedger ledger({1}, {{6, Before(6), Before(5)}}, &clock_);
  ASSERT_TRUE(ledger.Restore({0, 6, kVersion}, Before(7), 66));
  ledger.OpenIteration(9, kVersion);
  EXPECT_TRUE(ledger.Counts(0, 6, 66));
  ledger.RewindIteration();
  EXPECT_EQ(ledger.Snapshot(0, 6).value(), Before(6));
}

TEST_F(ResetTest, ADuplicateThatDiffersIsAnErrorThatNamesBoth) {
  ledger_.Join("a", "");
  ledger_.Join("b", "");
  Play("a", 6, 0x66);
  const auto push = [&](const std::string& actor, uint64_t digest) {
    testing::internal::CaptureStderr();
    EXPECT_EQ(ledger_.Accept(actor, {0, 6, kVersion}, Before(7), digest).value(), Verdict::kDuplicate);
    return testing::internal::GetCapturedStderr();
  };
  EXPECT_EQ(push("b", 0x66), "");
  EXPECT_EQ(push("stranger", 0x67), "") << "who never joined";
  EXPECT_EQ(ledger_.differing(), 0);
  EXPECT_THAT(push("b", 0x67), AllOf(HasSubstr("error"), HasSubstr("fragment 6 of lane 0"), HasSubstr("actor a sent"),
                                     HasSubstr("actor b sent")));
  EXPECT_EQ(push("b", 0x68), "") << "said once";
  EXPECT_EQ(ledger_.differing(), 2);
  // It may come after the next iteration was opened.
  Play("a", 7, 0x77);
  Play("a", 8, 0x88);
  ledger_.OpenIteration(10, kVersion + 1);
  EXPECT_EQ(ledger_.Accept("b", {0, 8, kVersion}, Before(9), 0x89).value(), Verdict::kDuplicate);
  EXPECT_EQ(ledger_.differing(), 3);
}

}  // namespace
}  // namespace craftfleet
