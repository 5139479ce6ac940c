// Draws the picture of a world, bit for bit as Crafter does: the map, lit (light.h), and the inventory.
//
// Map cells outside the world are grey (127, 127, 127). A cell shows the colour of its material's texture; alpha is
// ignored. Objects are drawn over it in order of creation, with Blend().

#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "envserver/render/inventory_strip.h"
#include "envserver/render/picture_layout.h"
#include "envserver/render/scene.h"
#include "envserver/render/sprites.h"
#include "envserver/render/textures.h"
#include "envserver/world/options.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/world.h"

namespace craftfleet {

// Immutable after Create(): one renderer serves any number of games on any number of threads.
class Renderer {
 public:
  // For worlds with the options `world`, whose view and appearance decide what is drawn. `textures` may be destroyed
  // after the call.
  //   InvalidArgument: options that Validate() refuses. NotFound: an appearance variant without a texture; names it.
  static absl::StatusOr<std::shared_ptr<const Renderer>> Create(const Textures& textures, const WorldOptions& world,
                                                                const RenderOptions& options);

  // Writes the picture to `frame`, uint8[height][width][3] of frame_bytes(). `world` has the options given to Create().
  // Where daylight is below 0.5, one uniform draw per map pixel is taken from `random`, in Crafter the world's own
  // stream.
  void Render(const World& world, RandomStream* random, absl::Span<uint8_t> frame) const;

  // The same in two steps: what the picture of a world shows, and the picture of a scene. A scene from elsewhere must
  // have num_cells() of ground, each ShowsAsGround(), things that each ShowsAsThing(), and all its values in range.
  void Capture(const World& world, Scene* scene) const;
  void Render(const Scene& scene, RandomStream* random, absl::Span<uint8_t> frame) const;

  int num_cells() const { return layout_.columns * layout_.map_rows; }  // of the map
  // Whether a world with these options can show the sprite, 0..255, in a cell's ground, or as a thing on it.
  bool ShowsAsGround(int sprite) const { return sprite == kOutside || (CanDraw(sprite) && IsMaterial(sprite)); }
  bool ShowsAsThing(int sprite) const { return CanDraw(sprite) && !IsMaterial(sprite); }
  // Words that a picture with noise draws from the stream.
  int noise_words() const { return 2 * layout_.map_width() * layout_.map_height(); }

  // Whether a picture of the world takes draws from the stream.
  static bool DrawsNoise(const World& world) { return world.daylight() < kNoiseBelow; }

  const WorldOptions& world_options() const { return world_options_; }
  int frame_bytes() const { return layout_.frame_bytes(); }

 private:
  Renderer(const Textures& textures, const WorldOptions& world, const RenderOptions& options);

  struct Tiles;

  bool CanDraw(int sprite) const { return sprite < kNumSprites && possible_[sprite]; }
  // Pixel[cell_width][tile_stride_].
  const Pixel* Tile(const Tiles& tiles, int tile) const;
  void LayThings(const Scene& scene, Tiles* tiles) const;
  // Every pixel has noise of its own, so the map is lit as a whole.
  void DrawMapByNight(const Scene& scene, const Tiles& tiles, RandomStream* random, uint8_t* frame) const;
  // Cells with the same tile look the same: each tile is lit once and copied.
  void DrawMapByDay(const Scene& scene, const Tiles& tiles, uint8_t* frame) const;
  // Lights a tile by day; `rgb` is uint8[cell_height][rgb_stride_], rows filled up with 0.
  void FinishTile(const Scene& scene, const Pixel* tile, uint8_t* rgb) const;

  const WorldOptions world_options_;
  const PictureLayout layout_;
  const InventoryStrip strip_;
  const bool inventory_;
  const int tile_stride_;                     // pixels from one column of a tile to the next; whole copy groups
  const int tile_pixels_;                     // of a tile
  const int rgb_stride_;                      // bytes from one row of a finished tile to the next; whole copy groups
  std::array<bool, kNumSprites> possible_{};  // whether a world with these options can show it
  std::vector<std::vector<Pixel>> tiles_;     // by sprite, empty without a texture; the last one: outside the world
  std::vector<double> cover_;                 // [map_width][map_height], and the rest of a block: the night's vignette
  std::vector<float> float_cover_;            // the same
};

}  // namespace craftfleet
