#include "common/telemetry/activity_meter.h"

#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

class ActivityMeterTest : public testing::Test {
 protected:
  void Spend(double seconds) { clock_.Advance(absl::Seconds(seconds)); }

  FakeClock clock_;
  ActivityMeter meter_{&clock_, Activity::kPermits};
};

TEST_F(ActivityMeterTest, TimeIsSplitByActivity) {
  Spend(1);
  meter_.Switch(Activity::kInference);
  Spend(2);
  EXPECT_EQ(meter_.Switch(Activity::kPermits), absl::Seconds(2));
  Spend(0.5);
  const Work work = meter_.Total();
  EXPECT_DOUBLE_EQ(work.times[Activity::kPermits], 1.5);
  EXPECT_DOUBLE_EQ(work.times[Activity::kInference], 2);
  EXPECT_DOUBLE_EQ(work.seconds, 3.5);
}

TEST_F(ActivityMeterTest, TheCurrentActivityIsIncludedUpToNow) {
  meter_.Switch(Activity::kUpdate);
  Spend(3600);
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kUpdate], 3600);
  const Work recent = meter_.Recent();
  EXPECT_DOUBLE_EQ(recent.times[Activity::kUpdate], recent.seconds);
  EXPECT_NEAR(recent.seconds, 20, 2.001);
}

TEST_F(ActivityMeterTest, SwitchAttributesPartOfTheTimeToAnotherActivity) {
  meter_.Switch(Activity::kWire);
  Spend(10);
  meter_.Switch(Activity::kOther, Activity::kEnvironment, absl::Seconds(4));
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kWire], 6);
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kEnvironment], 4);
}

TEST_F(ActivityMeterTest, SwitchAttributesAtMostTheElapsedTime) {
  meter_.Switch(Activity::kWire);
  Spend(1);
  meter_.Switch(Activity::kOther, Activity::kEnvironment, absl::Seconds(5));
  meter_.Switch(Activity::kOther, Activity::kEnvironment, absl::Seconds(-5));
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kWire], 0);
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kEnvironment], 1);
  EXPECT_DOUBLE_EQ(meter_.Total().seconds, 1);
}

TEST_F(ActivityMeterTest, NoTotalFallsWhenASpanThatWasIncludedIsSplit) {
  meter_.Switch(Activity::kWire);
  Spend(5);
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kWire], 5);
  Spend(1);
  meter_.Switch(Activity::kWire, Activity::kEnvironment, absl::Seconds(6));
  const Work work = meter_.Total();
  EXPECT_DOUBLE_EQ(work.times[Activity::kWire], 5);
  EXPECT_DOUBLE_EQ(work.times[Activity::kEnvironment], 6);
  EXPECT_DOUBLE_EQ(work.seconds, 6);
  Spend(7);
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kWire], 7) << "it has made up for what was returned too early";
}

TEST_F(ActivityMeterTest, RecentCoversOnlyTheWindow) {
  Spend(100);
  meter_.Switch(Activity::kInference);
  for (int i = 0; i < 300; ++i) {
    Spend(0.1);
    meter_.Switch(Activity::kInference);
  }
  const Work recent = meter_.Recent();
  EXPECT_DOUBLE_EQ(recent.times[Activity::kPermits], 0);
  EXPECT_NEAR(recent.seconds, 20, 2.001);
  EXPECT_NEAR(meter_.Total().times[Activity::kPermits], 100, 1e-9);
}

TEST_F(ActivityMeterTest, RatesAreMeasuredOverTheWindow) {
  for (int second = 0; second < 60; ++second) {
    Spend(1);
    meter_.Count(second < 30 ? 1000 : 7);
  }
  const Work recent = meter_.Recent();
  EXPECT_NEAR(recent.per_second, 7, 0.5);  // a count falls on the border
  EXPECT_EQ(meter_.Total().done, 30 * 1000 + 30 * 7);
}

TEST_F(ActivityMeterTest, RecentCoversAWholeCycleLongerThanTheWindow) {
  for (int cycle = 0; cycle < 3; ++cycle) {
    meter_.BeginCycle();
    meter_.Switch(Activity::kIntake);
    Spend(100);
    meter_.Count(4096);
    meter_.Switch(Activity::kUpdate);
    Spend(300);
  }
  meter_.BeginCycle();
  meter_.Switch(Activity::kIntake);
  Spend(50);
  const Work recent = meter_.Recent();
  EXPECT_DOUBLE_EQ(recent.times[Activity::kUpdate], 300);
  EXPECT_DOUBLE_EQ(recent.times[Activity::kIntake], 150);
  EXPECT_EQ(recent.done, 4096);
}

TEST_F(ActivityMeterTest, RecentCoversTheWindowWhenCyclesAreShort) {
  for (int cycle = 0; cycle < 100; ++cycle) {
    meter_.BeginCycle();
    Spend(1);
  }
  EXPECT_NEAR(meter_.Recent().seconds, 20, 2.001);
}

TEST_F(ActivityMeterTest, ToleratesAClockThatIsSetBack) {
  Spend(10);
  meter_.Switch(Activity::kInference);
  Spend(-5);
  meter_.Switch(Activity::kWire);
  EXPECT_DOUBLE_EQ(meter_.Total().seconds, 10);
  Spend(6);
  EXPECT_DOUBLE_EQ(meter_.Total().times[Activity::kWire], 1);
}

TEST(Work, ThreadsAddUp) {
  Work work;
  Work thread;
  thread.seconds = 2;
  thread.times[Activity::kWire] = 2;
  thread.done = 10;
  thread.per_second = 5;
  work.Add(thread);
  work.Add(thread);
  EXPECT_DOUBLE_EQ(work.seconds, 4);
  EXPECT_DOUBLE_EQ(work.times[Activity::kWire], 4);
  EXPECT_EQ(work.done, 20);
  EXPECT_DOUBLE_EQ(work.per_second, 10);
}

TEST(Activity, NamesParseBack) {
  for (const Activity activity : kActivities) EXPECT_EQ(ActivityByName(ActivityName(activity)), activity);
  EXPECT_EQ(ActivityByName("sleep"), std::nullopt);
}

}  // namespace
}  // namespace craftfleet
