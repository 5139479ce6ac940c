#include "learner/run/event_log.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/read_events.h"

namespace craftfleet {
namespace {

TEST(EventLog, BeginsWithTheVersionRecord) {
  const TempFolder folder;
  FakeClock clock;
  ASSERT_THAT(EventLog::Open(folder / "events", &clock), IsOk());
  const std::vector<v1::Event> events = ReadEvents(folder / "events");
  ASSERT_EQ(events.size(), 1U);
  EXPECT_EQ(events[0].file_version(), "brain.Event:2");
  EXPECT_EQ(events[0].wall_time(), 1'700'000'000.0);
  // The record's length, its masked checksum, wall time (field 1, double), then file version (field 3, 13 bytes).
  const std::string bytes = ReadFile(folder / "events").value();
  EXPECT_EQ(bytes.size(), 8U + 4 + 24 + 4);
  EXPECT_EQ(bytes.size(), static_cast<size_t>(kVersionRecordBytes));
  EXPECT_EQ(bytes.substr(0, 8), std::string("\x18\0\0\0\0\0\0\0", 8));
  EXPECT_EQ(bytes.substr(12, 1), "\x09");
  EXPECT_EQ(bytes.substr(21, 15),
            "\x1A\x0D"
            "brain.Event:2");
}

TEST(EventLog, ContainsTheAddedScalars) {
  const TempFolder folder;
  FakeClock clock;
  auto log = EventLog::Open(folder / "events", &clock);
  ASSERT_THAT(log, IsOk());
  clock.Advance(absl::Milliseconds(1500));
  log->AddScalars(4096, {{"train/reward", 1.5}, {"loss/value", -0.1}});
  ASSERT_THAT(log->file().Flush(), IsOk());
  const std::vector<v1::Event> events = ReadEvents(folder / "events");
  ASSERT_EQ(events.size(), 2U);
  EXPECT_EQ(events[1].step(), 4096);
  EXPECT_EQ(events[1].wall_time(), 1'700'000'001.5);
  ASSERT_EQ(events[1].summary().value_size(), 2);
  EXPECT_EQ(events[1].summary().value(0).tag(), "train/reward");
  EXPECT_EQ(events[1].summary().value(0).simple_value(), 1.5F);
  EXPECT_EQ(events[1].summary().value(1).tag(), "loss/value");
  EXPECT_EQ(events[1].summary().value(1).simple_value(), -0.1F);
}

TEST(EventLog, HistogramsCountEveryValueOnce) {
  const TempFolder folder;
  FakeClock clock;
  auto log = EventLog::Open(folder / "events", &clock);
  ASSERT_THAT(log, IsOk());
  log->AddHistograms(7, {{"spread", {-1, 0, 0.5, 2, 2}}, {"empty", {}}, {"equal", {3, 3}}});
  log->AddHistograms(8, {{"empty", {}}});
  ASSERT_THAT(log->file().Flush(), IsOk());
  const std::vector<v1::Event> events = ReadEvents(folder / "events");
  ASSERT_EQ(events.size(), 2U) << "without values there is nothing to write";
  ASSERT_EQ(events[1].summary().value_size(), 2);
  EXPECT_EQ(events[1].step(), 7);
  const auto& spread = events[1].summary().value(0).histo();
  EXPECT_EQ(spread.min(), -1);
  EXPECT_EQ(spread.max(), 2);
  EXPECT_EQ(spread.num(), 5);
  EXPECT_EQ(spread.sum(), 3.5);
  EXPECT_EQ(spread.sum_squares(), 9.25);
  ASSERT_EQ(spread.bucket_size(), 30);
  ASSERT_EQ(spread.bucket_limit_size(), 30);
  EXPECT_EQ(spread.bucket(0), 1) << "-1, up to -0.9";
  EXPECT_NEAR(spread.bucket_limit(0), -0.9, 1e-12);
  EXPECT_EQ(spread.bucket(29), 2) << "the largest value belongs to the last bucket";
  EXPECT_EQ(spread.bucket_limit(29), 2);
  const auto& equal = events[1].summary().value(1).histo();
  EXPECT_EQ(events[1].summary().value(1).tag(), "equal");
  ASSERT_EQ(equal.bucket_size(), 1);
  EXPECT_EQ(equal.bucket(0), 2);
  EXPECT_EQ(equal.bucket_limit(0), 3);
}

TEST(EventLog, AfterAFullDiskEventsKeepTheirOriginalTime) {
  const TempFolder folder;
  FakeClock clock;
  auto log = EventLog::Open(folder / "events", &clock);
  {
    const FileSizeLimit limit(log->file().length() + 10);
    log->AddScalars(1, {{"a", 1}});
    EXPECT_THAT(log->file().Flush(), StatusIs(absl::StatusCode::kResourceExhausted, testing::_));
    EXPECT_EQ(ReadEvents(folder / "events").size(), 1U) << "no partial record";
  }
  clock.Advance(absl::Seconds(100));
  log->AddScalars(2, {{"a", 2}});
  ASSERT_THAT(log->file().Flush(), IsOk());
  const std::vector<v1::Event> events = ReadEvents(folder / "events");
  ASSERT_EQ(events.size(), 3U);
  EXPECT_EQ(events[1].step(), 1);
  EXPECT_EQ(events[1].wall_time(), 1'700'000'000.0);
  EXPECT_EQ(events[2].wall_time(), 1'700'000'100.0);
}

}  // namespace
}  // namespace craftfleet
