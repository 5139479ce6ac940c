// The lower part of the picture: an icon and a digit for each item that the player has, on black.
//
// An item with amount >= 1 has the cell (index mod view_width, index div view_width) of the strip: its icon,
// trunc(0.8 * cell) pixels a side, at offset trunc(cell number * cell + 0.1 * cell); over it the digit of the amount,
// trunc(0.6 * cell) pixels, at offset trunc(cell number * cell + 0.4 * cell). Both are drawn with Blend().

#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <absl/types/span.h>

#include "common/base/crafter.h"
#include "envserver/render/picture_layout.h"
#include "envserver/render/textures.h"
#include "envserver/world/state.h"

namespace craftfleet {

// Immutable after construction: may be shared between threads.
class InventoryStrip {
 public:
  InventoryStrip(const Textures& textures, const PictureLayout& layout);

  // Draws onto `frame`, uint8[height][width][3], whose strip is black.
  void Draw(const std::array<int8_t, kNumItems>& inventory, absl::Span<uint8_t> frame) const;

 private:
  // The finished cell of an item: uint8[cell_height][cell_width][3].
  const uint8_t* CellOf(int item, int amount) const {
    return cells_.data() + (item * kMaxItem + amount - 1) * cell_bytes_;
  }

  PictureLayout layout_;
  int cell_bytes_;
  std::vector<uint8_t> cells_;  // [item][amount - 1]
};

}  // namespace craftfleet
