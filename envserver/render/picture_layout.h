// Where the parts of a picture are: the local map above, the inventory below, a black border where the cells don't fill
// the size.
//
// A picture shows view_width x view_height cells of width div view_width by height div view_height pixels. The lowest
// ceil(16 / view_width) rows of cells are the inventory, the rest is the map, whose middle cell is the player's: the
// upper left cell of the view is the player's position minus (columns div 2, map rows div 2). Half of the remaining
// pixels, rounded down, are at the left and the top.

#pragma once

#include <absl/status/statusor.h>

#include "envserver/world/options.h"

namespace craftfleet {

struct RenderOptions {
  int width = 64;         // pixels, 2 * view_width..2048
  int height = 64;        // pixels, 2 * view_height..2048
  bool inventory = true;  // off: its part stays black, nothing else changes

  // InvalidArgument names the field, its value and the range that the view allows.
  absl::Status Validate(const WorldOptions& world) const;
};

// Lengths in pixels unless stated otherwise.
struct PictureLayout {
  // Both options must be valid.
  PictureLayout(const WorldOptions& world, const RenderOptions& options);

  int width;        // of the whole picture
  int height;       // of the whole picture
  int cell_width;   // of one cell
  int cell_height;  // of one cell
  int columns;      // cells across
  int map_rows;     // cells down the map
  int border_left;
  int border_top;

  int map_width() const { return columns * cell_width; }
  int map_height() const { return map_rows * cell_height; }
  int frame_bytes() const { return width * height * 3; }
  // Offset in a frame of the red byte of pixel (x, y), counted from the upper left corner inside the border.
  int Offset(int x, int y) const { return ((border_top + y) * width + border_left + x) * 3; }
};

}  // namespace craftfleet
