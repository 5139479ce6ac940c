// Rows from columns, on each CPU path.

#include "envserver/render/rows.h"

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gtest/gtest.h>

#include "envserver/world/random_stream.h"
#include "tests/fakes/cpu_paths.h"

namespace craftfleet {
namespace {

class WriteRowsOnEachCpu : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(WriteRowsOnEachCpu);

TEST_P(WriteRowsOnEachCpu, WritesThePixelsAndAtMostAByteMore) {
  constexpr uint8_t kBefore = 0xee;
  RandomStream random(3);
  for (const int width : {1, 4, 7, 15, 16, 17, 33, 63}) {
    for (const int height : {1, 7, 16, 31, 32, 49}) {
      const std::string size = absl::StrCat(width, "x", height);
      const int stride = height + static_cast<int>(random.Below(3));
      const int row_bytes = 3 * width + 5;
      std::vector<Pixel> columns(width * stride);
      for (Pixel& pixel : columns) pixel = random.Below(1 << 24);
      std::vector<uint8_t> rows(height * row_bytes, kBefore);
      WriteRows(columns.data(), stride, width, height, rows.data(), row_bytes);
      for (int y = 0; y < height; ++y) {
        const uint8_t* row = rows.data() + y * row_bytes;
        for (int i = 0; i < 3 * width; ++i) {
          ASSERT_EQ(row[i], columns[i / 3 * stride + y] >> i % 3 * 8 & 255) << size << ": row " << y << ", byte " << i;
        }
        for (int i = 3 * width + 1; i < row_bytes; ++i) ASSERT_EQ(row[i], kBefore) << size << ": after row " << y;
      }
    }
  }
}

}  // namespace
}  // namespace craftfleet
