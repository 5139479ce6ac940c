// From pixels in columns, as the map is drawn, to the rows of a frame.

#pragma once

#include <cstdint>

#include "envserver/render/textures.h"

namespace craftfleet {

// Writes Pixel[width][height] without alpha, `stride` pixels from column to column, as rows of red, green and blue,
// `row_bytes` apart. May write one more byte after a row: 0.
void WriteRows(const Pixel* columns, int stride, int width, int height, uint8_t* rows, int row_bytes);

}  // namespace craftfleet
