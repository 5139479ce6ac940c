// What a picture shows, apart from the night's noise: from it a renderer draws the picture without the world.

#pragma once

#include <array>
#include <cstdint>

#include <absl/container/inlined_vector.h>

#include "common/base/crafter.h"
#include "envserver/render/light.h"
#include "envserver/render/sprites.h"

namespace craftfleet {

// Ground outside the world.
inline constexpr int kOutside = kNumSprites;
static_assert(kOutside <= 255);

// Cells of the view are numbered column by column, as [columns][map_rows]. Views up to Crafter's 9x7 cells need no
// memory from the heap.
struct Scene {
  static constexpr int kSmallView = 9 * 7;

  struct Thing {
    uint16_t cell = 0;
    uint8_t sprite = 0;  // of a creature, the player, an arrow or a plant
  };

  absl::InlinedVector<uint8_t, kSmallView> ground;  // by cell: a material's sprite, or kOutside
  absl::InlinedVector<Thing, kSmallView> things;    // by cell, ascending; each cell at most once
  std::array<int8_t, kNumItems> inventory{};        // 0..9
  double daylight = 0;                              // 0..1
  bool sleeping = false;

  // Whether the picture has noise.
  bool is_dark() const { return daylight < kNoiseBelow; }
};

}  // namespace craftfleet
