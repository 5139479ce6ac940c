// Lanes with invalid snapshots are reset, and duplicate fragments are compared.
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/scheduling/lane_scheduler.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace lane_scheduler_reset_test {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneScheduler::Verdict;

constexpr int64_t kVersion = 3;

// The scheduler without a registry, with the records of its actors.
class Lanes : public LaneScheduler {
 public:
  Lanes(const Options& options, std::vector<LaneRecord> records, Clock* clock)
      : LaneScheduler(options, std::move(records), clock), clock_(clock) {}

  void Join(const std::string& actor, const std::string& client) {
    Worker& worker = workers_[actor];
    worker.name = actor;
    worker.client = {client, "one host"};
    worker.leased_from = clock_->Now();
    worker.lease = Options().lease;
    table().Add(&worker);
  }
  void Leave(const std::string& actor) { Remove(actor); }
  // The actor is busy: it keeps its lease.
  void Touch(const std::string& actor) { workers_[actor].leased_from = clock_->Now(); }
  // Like WorkerRegistry, without waiting.
  std::vector<Permit> Ask(const std::string& actor, const std::vector<Permit>& active) {
    if (table().Find(actor) != nullptr) workers_[actor].leased_from = clock_->Now();
    RemoveExpired();
    if (table().Find(actor) == nullptr) return {};
    Renew(actor, active, 1);
    return Grant(actor);
  }

 private:
  Clock* const clock_;
  std::map<std::string, Worker> workers_;
};

// One lane whose iteration has fragments 6 to 8; it began with the snapshots "before 5" and "before 6".
class ResetTest : public testing::Test {
 protected:
  void SetUp() override { scheduler_.rollouts().OpenIteration(9, kVersion); }

  std::vector<Permit> Ask(const std::string& actor, const std::vector<Permit>& active = {}) {
    return scheduler_.Ask(actor, active);
  }
  // Plays a fragment.
  void Play(const std::string& actor, int64_t fragment, uint64_t digest = 0) {
    ASSERT_THAT(Ask(actor), testing::ElementsAre(Permit{0, fragment, kVersion}));
    const auto verdict = scheduler_.Accept(actor, {0, fragment, kVersion}, Before(fragment + 1), digest);
    ASSERT_EQ(verdict.value(), Verdict::kAccepted);
  }
  static LaneSnapshot Before(int64_t fragment) {
    return {"before " + std::to_string(fragment), {static_cast<float>(fragment)}};
  }
  // Gets the permit and returns it.
  void Refuse(const std::string& actor, int64_t fragment) {
    ASSERT_THAT(Ask(actor), testing::ElementsAre(Permit{0, fragment, kVersion})) << actor;
    scheduler_.reports().Add(actor, 0, fragment, "bytes \x1b[2J");
  }
  int64_t Next() const { return scheduler_.table().Records()[0].next_fragment; }

  FakeClock clock_;
  Lanes scheduler_{{1}, {{6, Before(6), Before(5)}}, &clock_};
};

TEST_F(ResetTest, ASecondActorMustFailBeforeALaneIsReset) {
  scheduler_.Join("liar", "");
  scheduler_.Join("a", "");
  scheduler_.Join("b", "");
  Play("liar", 6);
  Play("liar", 7);
  scheduler_.Leave("liar");
  Refuse("a", 8);
  EXPECT_THAT(Ask("a"), IsEmpty()) << "b is preferred";
  EXPECT_EQ(Next(), 8);
  testing::internal::CaptureStderr();
  Refuse("b", 8);
  EXPECT_EQ(Next(), 6) << "the beginning of the iteration, so that the result does not change";
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("lane 0: the snapshot after its fragment 7, from actor liar, is not a game"),
                    HasSubstr("bytes ?[2J"), HasSubstr("played again from fragment 6 on")));
  EXPECT_EQ(scheduler_.table().counters.resets, 1);
  EXPECT_EQ(scheduler_.table().Snapshot(0, 6).value(), Before(6));
  for (int64_t fragment = 6; fragment < 9; ++fragment) Play("a", fragment);
  EXPECT_THAT(Ask("a"), IsEmpty());
}

TEST_F(ResetTest, RolledBackFragmentsNoLongerCount) {
  scheduler_.Join("liar", "");
  Play("liar", 6, 66);
  EXPECT_TRUE(scheduler_.table().Counts(0, 6, 66));
  EXPECT_FALSE(scheduler_.table().Counts(0, 6, 67));
  Refuse("liar", 7);
  Refuse("liar", 7);
  EXPECT_FALSE(scheduler_.table().Counts(0, 6, 66));
  Play("liar", 6, 67);
  EXPECT_TRUE(scheduler_.table().Counts(0, 6, 67));
}

TEST_F(ResetTest, ASecondFailureOfTheSameActorDoesNotResetTheLane) {
  scheduler_.Join("a", "");
  scheduler_.Join("b", "");
  Refuse("a", 6);
  clock_.Advance(absl::Seconds(5));
  EXPECT_THAT(Ask("b", {}), SizeIs(1));
  ASSERT_EQ(scheduler_.Accept("b", {0, 6, kVersion}, Before(7)).value(), Verdict::kAccepted);
  EXPECT_EQ(scheduler_.table().counters.resets, 0) << "b could play it";
  scheduler_.reports().Add("a", 0, 6, "late");
  scheduler_.reports().Add("stranger", 0, 7, "never asked");
  scheduler_.reports().Add("a", 17, 7, "no such lane");
  EXPECT_EQ(Next(), 7);
}

// Before, its second name confirmed what the first one had reported, and the lane was reset.
TEST_F(ResetTest, AClientWithManyNamesDoesNotResetALane) {
  for (const char* actor : {"l1", "l2", "l3", "l4", "l5", "l6"}) scheduler_.Join(actor, "liar");
  scheduler_.Join("a", "honest");
  Refuse("l1", 6);
  EXPECT_THAT(Ask("l2"), IsEmpty()) << "actors of other clients are preferred";
  // The other client is busy for so long that the liar's actors get the lane again and again.
  for (const char* actor : {"l2", "l1", "l3", "l4", "l5", "l6"}) {
    clock_.Advance(absl::Seconds(3));
    scheduler_.Touch("a");
    clock_.Advance(absl::Seconds(3));
    scheduler_.Join(actor, "liar");
    Refuse(actor, 6);
    scheduler_.Touch("a");
  }
  EXPECT_EQ(scheduler_.table().counters.resets, 0);
  Play("a", 6);
}

TEST_F(ResetTest, AnotherClientConfirmsAReport) {
  scheduler_.Join("l1", "liar");
  scheduler_.Join("a", "honest");
  Refuse("a", 6);
  Refuse("l1", 6);
  EXPECT_EQ(scheduler_.table().counters.resets, 1);
  scheduler_.Leave("l1");
  Refuse("a", 6);
  EXPECT_EQ(scheduler_.table().counters.resets, 1);
  Refuse("a", 6);
  EXPECT_EQ(scheduler_.table().counters.resets, 2) << "nobody else can play";
}

TEST_F(ResetTest, WithOneCertificateForAllAnotherActorConfirmsAReport) {
  for (const char* actor : {"a", "b", "c"}) scheduler_.Join(actor, "certificate of all");
  Refuse("b", 6);
  clock_.Advance(absl::Seconds(1));
  Refuse("c", 6);
  EXPECT_EQ(scheduler_.table().counters.resets, 1);
}

TEST_F(ResetTest, WithoutIdentitiesAClientIsAHost) {
  const WorkerClient stranger = {"", "10.0.0.7"};
  EXPECT_EQ(stranger.Name(), "10.0.0.7");
  EXPECT_EQ((WorkerClient{"certificate a", "10.0.0.7"}.Name()), "certificate a");
}

TEST_F(ResetTest, ActorsThatNeitherPlayNorReportDoNotKeepALaneBroken) {
  scheduler_.Join("a", "honest");
  const auto report_while_mute_is_there = [this] {
    clock_.Advance(absl::Seconds(6));
    scheduler_.Touch("a");
    scheduler_.Join("mute", "other");
    Refuse("a", 6);
  };
  for (int i = 0; i < 10; ++i) {
    report_while_mute_is_there();
    EXPECT_EQ(scheduler_.table().counters.resets, 0) << i;
    EXPECT_THAT(Ask("mute"), SizeIs(1));
    if (i == 1) {
      EXPECT_THAT(Ask("mute"), IsEmpty()) << "it returns the permit";
    } else {
      scheduler_.Leave("mute");
    }
  }
  report_while_mute_is_there();
  EXPECT_EQ(scheduler_.table().counters.resets, 1) << "after a minute";
}

TEST_F(ResetTest, AtTheBeginningOfAnIterationALaneIsResetToItsPreviousSnapshot) {
  scheduler_.Join("a", "");
  Refuse("a", 6);
  EXPECT_EQ(scheduler_.table().counters.resets, 0);
  Refuse("a", 6);
  EXPECT_EQ(scheduler_.table().counters.resets, 1);
  EXPECT_EQ(scheduler_.table().Snapshot(0, 6).value(), Before(5))
      << "the same fragment number, from the snapshot before the previous fragment";
  // That snapshot is invalid too: the lane is reset to a new game, which always works.
  Refuse("a", 6);
  Refuse("a", 6);
  EXPECT_EQ(scheduler_.table().Snapshot(0, 6).value(), (LaneSnapshot{"", {0}}));
  EXPECT_EQ(scheduler_.table().counters.resets, 2);
  for (int i = 0; i < 5; ++i) Refuse("a", 6);
  EXPECT_EQ(scheduler_.table().counters.resets, 2);
  Play("a", 6);
}

TEST_F(ResetTest, AResetLaneIsRolledBackToItsResetPoint) {
  scheduler_.Join("a", "");
  for (int i = 0; i < 2; ++i) Refuse("a", 6);
  Play("a", 6);
  scheduler_.rollouts().RewindIterations(1);
  EXPECT_EQ(scheduler_.table().Snapshot(0, 6).value(), Before(5));
}

TEST_F(ResetTest, AnIterationCanBeRolledBack) {
  scheduler_.Join("a", "");
  Play("a", 6, 66);
  Play("a", 7, 77);
  scheduler_.rollouts().RewindIterations(1);
  EXPECT_THAT(Ask("a"), IsEmpty()) << "until it is opened again";
  EXPECT_FALSE(scheduler_.table().Counts(0, 7, 77));
  EXPECT_EQ(scheduler_.table().Snapshot(0, 6).value(), Before(6));
  scheduler_.rollouts().OpenIteration(9, kVersion);
  for (int64_t fragment = 6; fragment < 9; ++fragment) Play("a", fragment);
}

TEST_F(ResetTest, ADifferingDuplicateIsLoggedWithBothSenders) {
  scheduler_.Join("a", "");
  scheduler_.Join("b", "");
  Play("a", 6, 0x66);
  const auto push = [&](const std::string& actor, uint64_t digest) {
    testing::internal::CaptureStderr();
    EXPECT_EQ(scheduler_.Accept(actor, {0, 6, kVersion}, Before(7), digest).value(), Verdict::kDuplicate);
    return testing::internal::GetCapturedStderr();
  };
  EXPECT_EQ(push("b", 0x66), "");
  EXPECT_EQ(push("stranger", 0x67), "") << "it never joined";
  EXPECT_EQ(scheduler_.table().counters.differing, 0);
  EXPECT_THAT(push("b", 0x67), AllOf(HasSubstr("error"), HasSubstr("fragment 6 of lane 0"), HasSubstr("actor a sent"),
                                     HasSubstr("actor b sent")));
  EXPECT_EQ(push("b", 0x68), "") << "logged once";
  EXPECT_EQ(scheduler_.table().counters.differing, 2);
  // The duplicate may arrive after the next iteration was opened.
  Play("a", 7, 0x77);
  Play("a", 8, 0x88);
  scheduler_.rollouts().OpenIteration(10, kVersion + 1);
  EXPECT_EQ(scheduler_.Accept("b", {0, 8, kVersion}, Before(9), 0x89).value(), Verdict::kDuplicate);
  EXPECT_EQ(scheduler_.table().counters.differing, 3);
}

}  // namespace lane_scheduler_reset_test
}  // namespace craftfleet
