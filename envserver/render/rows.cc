#include "envserver/render/rows.h"

#include <cstring>

#include "common/base/cpu_path.h"

namespace craftfleet {
namespace {

CRAFTFLEET_KERNEL_BODY void WritePixels(const Pixel* columns, int stride, int width, int height, uint8_t* rows,
                                        int row_bytes) {
  for (int y = 0; y < height; ++y) {
    const Pixel* from = columns + y;
    uint8_t* to = rows + y * row_bytes;
    // The alpha byte, 0, is overwritten by the next pixel's red.
    const auto write = [&] {
      std::memcpy(to, from, sizeof(Pixel));
      from += stride;
      to += 3;
    };
    int x = 0;
    for (; x + 4 <= width; x += 4) {  // unrolled: 0.6 instead of 1.1 us for a map of 63x49
      write();
      write();
      write();
      write();
    }
    for (; x < width; ++x) write();
  }
}
CRAFTFLEET_KERNEL(WriteColumns, WritePixels)

}  // namespace

void WriteRows(const Pixel* columns, int stride, int width, int height, uint8_t* rows, int row_bytes) {
  WriteColumns(columns, stride, width, height, rows, row_bytes);
}

}  // namespace craftfleet
