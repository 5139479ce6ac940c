// Draws the picture of a world, bit for bit as Crafter does.
// Source: Crafter's rules, "The picture"; determinism page, section 8.

#ifndef CRAFTFLEET_ENVSERVER_RENDER_RENDERER_H_
#define CRAFTFLEET_ENVSERVER_RENDER_RENDERER_H_

#include <cstdint>
#include <memory>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "envserver/render/inventory_strip.h"
#include "envserver/render/picture_layout.h"
#include "envserver/render/sprites.h"
#include "envserver/render/textures.h"
#include "envserver/world/options.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/world.h"

namespace craftfleet {

// Immutable after Create(): one renderer serves any number of games on any number of threads.
class Renderer {
 public:
  // For worlds with the options `world`, whose view and appearance decide what is drawn. `textures` need not outlive
  // the call.
  //   InvalidArgument: options that Validate() refuses. NotFound: an appearance variant without a texture; names it.
  static absl::StatusOr<std::shared_ptr<const Renderer>> Create(const Textures& textures, const WorldOptions& world,
                                                                const RenderOptions& options);

  // Writes the picture to `frame`, uint8[height][width][3] of frame_bytes(). `world` has the options given to Create().
  // Where daylight is below 0.5, one uniform draw a map pixel is taken from `random`, in Crafter the world's own
  // stream.
  void Render(const World& world, RandomStream* random, absl::Span<uint8_t> frame) const;

  const WorldOptions& world_options() const { return world_options_; }
  int width() const { return layout_.width; }
  int height() const { return layout_.height; }
  int frame_bytes() const { return layout_.frame_bytes(); }

 private:
  Renderer(const Textures& textures, const WorldOptions& world, const RenderOptions& options);

  struct MapView;

  // Of a sprite that worlds with these options can show.
  absl::Span<const Pixel> Tile(Sprite sprite) const;
  // Fills `map`, Pixel[map_width][map_height] and space for a group of pixels more; lit where `lit_by_day`.
  void PaintMap(const World& world, bool lit_by_day, Pixel* map) const;
  void LayGround(MapView* view) const;
  void LayObjects(MapView* view) const;
  // A new tile: the ground, an object on it unless empty, and the day's light if it is lit tile by tile.
  const Pixel* MakeTile(absl::Span<const Pixel> ground, absl::Span<const Pixel> object, MapView* view) const;
  void WriteMap(const Pixel* map, uint8_t* frame) const;

  const WorldOptions world_options_;
  const PictureLayout layout_;
  const InventoryStrip strip_;
  const bool inventory_;
  // Tiles are textures at a cell's size, Pixel[cell_width][tile_stride_]; a column is padded to whole groups.
  const int tile_stride_;
  const int tile_pixels_;
  std::vector<std::vector<Pixel>> tiles_;  // by sprite; empty: no texture; the last one: outside the world
  std::vector<double> cover_;              // [map_width][map_height]: the night's vignette
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_RENDER_RENDERER_H_
