#include "learner/run/event_log.h"

#include <array>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/files.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

// Bit by bit, to check the log's table-driven one.
uint32_t SlowMaskedCrc(const std::string& bytes) {
  uint32_t crc = ~0U;
  for (const unsigned char byte : bytes) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1) != 0 ? (crc >> 1) ^ 0x82F63B78U : crc >> 1;
  }
  crc = ~crc;
  return ((crc >> 15) | (crc << 17)) + 0xA282EAD8U;
}

template <typename T>
T Take(const std::string& bytes, size_t* position) {
  T value{};
  EXPECT_LE(*position + sizeof(T), bytes.size());
  std::memcpy(&value, bytes.data() + *position, sizeof(T));
  *position += sizeof(T);
  return value;
}

// An independent reader of the TFRecord framing, which checks every checksum.
std::vector<v1::Event> ReadEvents(const std::string& path) {
  const std::string bytes = ReadFile(path).value();
  std::vector<v1::Event> events;
  size_t position = 0;
  while (position < bytes.size()) {
    const std::string length_bytes = bytes.substr(position, 8);
    const auto length = Take<uint64_t>(bytes, &position);
    EXPECT_EQ(Take<uint32_t>(bytes, &position), SlowMaskedCrc(length_bytes));
    const std::string data = bytes.substr(position, length);
    position += length;
    EXPECT_EQ(Take<uint32_t>(bytes, &position), SlowMaskedCrc(data));
    v1::Event event;
    EXPECT_TRUE(event.ParseFromString(data));
    events.push_back(event);
  }
  EXPECT_EQ(position, bytes.size());
  return events;
}

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
  EXPECT_EQ(bytes.substr(0, 8), std::string("\x18\0\0\0\0\0\0\0", 8));
  EXPECT_EQ(bytes.substr(12, 1), "\x09");
  EXPECT_EQ(bytes.substr(21, 15),
            "\x1A\x0D"
            "brain.Event:2");
}

TEST(EventLog, HoldsTheScalarsAdded) {
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

TEST(EventLog, CanBeCutBackAndGoneOnWith) {
  const TempFolder folder;
  FakeClock clock;
  int64_t length = 0;
  {
    auto log = EventLog::Open(folder / "events", &clock);
    log->AddScalars(1, {{"a", 1}});
    ASSERT_THAT(log->file().Flush(), IsOk());
    length = log->file().length();
    log->AddScalars(2, {{"a", 2}});
    ASSERT_THAT(log->file().Flush(), IsOk());
  }
  auto log = EventLog::Open(folder / "events", &clock);
  ASSERT_THAT(log->file().TruncateTo(length), IsOk());
  log->AddScalars(3, {{"a", 3}});
  ASSERT_THAT(log->file().Flush(), IsOk());
  const std::vector<v1::Event> events = ReadEvents(folder / "events");
  ASSERT_EQ(events.size(), 3U);
  EXPECT_EQ(events[1].step(), 1);
  EXPECT_EQ(events[2].step(), 3);
}

TEST(EventLog, WhatAFullDiskDoesNotTakeIsWrittenLaterWithTheTimeItHappened) {
  const TempFolder folder;
  FakeClock clock;
  auto log = EventLog::Open(folder / "events", &clock);
  {
    const FileSizeLimit limit(log->file().length() + 10);
    log->AddScalars(1, {{"a", 1}});
    EXPECT_THAT(log->file().Flush(), StatusIs(absl::StatusCode::kResourceExhausted, testing::_));
    EXPECT_EQ(ReadEvents(folder / "events").size(), 1U) << "no half record";
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
