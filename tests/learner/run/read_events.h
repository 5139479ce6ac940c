// Reads TensorBoard's event files.

#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/io/files.h"
#include "craftfleet/v1/event.pb.h"

namespace craftfleet {

// Computes the checksum bit by bit, to check the log's table-driven code.
inline uint32_t SlowMaskedCrc(const std::string& bytes) {
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
inline std::vector<v1::Event> ReadEvents(const std::string& path) {
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

}  // namespace craftfleet
