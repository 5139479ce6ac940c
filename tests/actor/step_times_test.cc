#include "actor/step_times.h"

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

// Steps of some servers, one after the other.
class StepTimesTest : public testing::Test {
 protected:
  // Plays for `duration` on `server`: `quick` steps of 2 ms, then one of `slow`, again and again.
  void Play(const std::string& server, absl::Duration duration, int quick, absl::Duration slow) {
    absl::Time now = start_;
    while (now < start_ + duration) {
      for (int i = 0; i < quick; ++i) times_.Add(server, absl::Milliseconds(2), now += absl::Milliseconds(2));
      if (slow > absl::ZeroDuration()) times_.Add(server, slow, now += slow);
    }
  }
  bool IsSlow(const std::string& server) { return times_.IsSlow(server, times_.TypicalOf(server).value()); }

  const absl::Time start_ = absl::UnixEpoch();
  StepTimes times_;
};

TEST_F(StepTimesTest, NothingIsKnownBeforeAWindowEnds) {
  Play("a", StepTimes::kWindow - absl::Milliseconds(100), 1, absl::ZeroDuration());
  EXPECT_FALSE(times_.TypicalOf("a").has_value());
  EXPECT_FALSE(times_.OthersOf("b").has_value());
}

TEST_F(StepTimesTest, AServerThatStopsAgainAndAgainIsSlow) {
  Play("good", absl::Seconds(4), 1, absl::ZeroDuration());
  Play("stops", absl::Seconds(4), 25, absl::Milliseconds(950));
  EXPECT_EQ(times_.TypicalOf("good"), absl::Milliseconds(2));
  EXPECT_TRUE(IsSlow("stops"));
  EXPECT_TRUE(times_.IsSlowerThanOthers("stops", *times_.TypicalOf("stops")));
  EXPECT_FALSE(IsSlow("good"));
}

TEST_F(StepTimesTest, AStepOfMostOfTheWindowIsEnough) {
  Play("good", absl::Seconds(4), 1, absl::ZeroDuration());
  EXPECT_TRUE(times_.Add("stops", absl::Seconds(9), start_ + absl::Seconds(10)));
  EXPECT_TRUE(IsSlow("stops"));
}

TEST_F(StepTimesTest, ServersThatTakeTwiceAsLongOrAreFastEnoughAreNotSlow) {
  Play("good", absl::Seconds(4), 0, absl::Milliseconds(20));
  Play("far", absl::Seconds(4), 0, absl::Milliseconds(40));
  EXPECT_FALSE(IsSlow("far"));
  StepTimes quick;
  EXPECT_FALSE(quick.IsSlow("a", StepTimes::kNeverSlow - absl::Milliseconds(1)));
}

TEST_F(StepTimesTest, OneServerIsComparedWithItsBestTime) {
  Play("alone", absl::Seconds(4), 1, absl::ZeroDuration());
  EXPECT_FALSE(IsSlow("alone"));
  Play("alone", absl::Seconds(8), 8, absl::Milliseconds(950));
  EXPECT_TRUE(IsSlow("alone"));
  EXPECT_FALSE(times_.IsSlowerThanOthers("alone", *times_.TypicalOf("alone")));
}

TEST_F(StepTimesTest, AForgottenServerIsNotComparedWithItsBestTime) {
  Play("alone", absl::Seconds(4), 1, absl::ZeroDuration());
  times_.Forget("alone");
  Play("alone", absl::Seconds(4), 8, absl::Milliseconds(950));
  EXPECT_FALSE(IsSlow("alone"));
}

TEST_F(StepTimesTest, OneServerThatWasNeverFastIsSlowByItself) {
  Play("alone", absl::Seconds(4), 0, absl::Milliseconds(400));
  EXPECT_TRUE(IsSlow("alone"));
}

TEST_F(StepTimesTest, MostServersDecideWhatIsSlow) {
  for (const char* server : {"a", "b", "c"}) Play(server, absl::Seconds(4), 0, absl::Milliseconds(60));
  Play("local", absl::Seconds(4), 0, absl::Milliseconds(1));
  for (const char* server : {"a", "b", "c"}) EXPECT_FALSE(IsSlow(server)) << "one quick server makes no other slow";
}

TEST_F(StepTimesTest, AServerThatIsResetNoLongerCountsForOthers) {
  Play("gone", absl::Seconds(4), 0, absl::Milliseconds(60));
  EXPECT_TRUE(times_.OthersOf("b").has_value());
  times_.Reset("gone");
  EXPECT_FALSE(times_.OthersOf("b").has_value());
  EXPECT_FALSE(times_.TypicalOf("gone").has_value());
}

}  // namespace
}  // namespace craftfleet
