#include "common/base/crc32c.h"

#include <array>

#include "common/base/little_endian.h"

namespace craftfleet {
namespace {

constexpr uint32_t kReversedPolynomial = 0x82F63B78;
constexpr int kSlices = 8;  // bytes in a step

using Table = std::array<uint32_t, 256>;

// tables[n][b]: the effect of byte b on the checksum n bytes later. With a table for each of eight bytes in a row,
// their lookups do not wait for each other (slicing, Kounavis and Berry 2005).
constexpr std::array<Table, kSlices> MakeTables() {
  std::array<Table, kSlices> tables{};
  for (uint32_t byte = 0; byte < 256; ++byte) {
    uint32_t crc = byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? kReversedPolynomial : 0);
    tables[0][byte] = crc;
  }
  for (int slice = 1; slice < kSlices; ++slice) {
    for (uint32_t byte = 0; byte < 256; ++byte) {
      const uint32_t before = tables[slice - 1][byte];
      tables[slice][byte] = (before >> 8) ^ tables[0][before & 0xFF];
    }
  }
  return tables;
}

constexpr std::array<Table, kSlices> kTables = MakeTables();

}  // namespace

uint32_t Crc32c(absl::string_view bytes) {
  uint32_t crc = 0xFFFFFFFF;
  for (; bytes.size() >= kSlices; bytes.remove_prefix(kSlices)) {
    const uint64_t word = FromLittleEndian<uint64_t>(bytes.substr(0, kSlices)) ^ crc;
    crc = 0;
    for (int i = 0; i < kSlices; ++i) crc ^= kTables[kSlices - 1 - i][word >> (8 * i) & 0xFF];
  }
  for (const char byte : bytes) crc = (crc >> 8) ^ kTables[0][(crc ^ static_cast<uint8_t>(byte)) & 0xFF];
  return ~crc;
}

}  // namespace craftfleet
