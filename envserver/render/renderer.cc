#include "envserver/render/renderer.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <string>

#include <absl/container/fixed_array.h>
#include <absl/strings/str_cat.h>

#include "common/check.h"
#include "common/status_macros.h"
#include "envserver/render/image.h"
#include "envserver/render/light.h"
#include "envserver/render/vignette.h"

namespace craftfleet {
namespace {

constexpr Pixel kGrey = 127 | 127 << 8 | 127 << 16;
constexpr Sprite kOutside = kNumSprites;
constexpr int kCopyGroup = 8;  // pixels that CopyColumn moves at once
// Scratch up to these sizes lies on the stack: enough for 64x64 pictures.
constexpr int kSmallView = 9 * 7;
constexpr int kSmallTile = 7 * 8;
constexpr int kSmallMap = 63 * 49 + kCopyGroup;

Sprite GroundAt(const World& world, Position p) {
  const Material material = world.material(p);
  return material == Material::kNone ? kOutside : SpriteOf(material, world.variant(p));
}

// Copies `count` pixels and up to kCopyGroup - 1 more: moves of a fixed size take a third of the time.
void CopyColumn(const Pixel* from, int count, Pixel* to) {
  for (int i = 0; i < count; i += kCopyGroup) std::memcpy(to + i, from + i, kCopyGroup * sizeof(Pixel));
}

}  // namespace

// What Render() works with while it paints the map.
struct Renderer::MapView {
  const World& world;
  Position corner;      // the world's cell in the upper left corner of the view; may lie outside
  bool lit_by_day;      // tiles are lit one by one; else the map is lit as a whole, later
  const Pixel** cells;  // [columns][map_rows]: the tile that each shows
  Pixel* free_tile;     // where the next tile made for this picture goes
};

absl::StatusOr<std::shared_ptr<const Renderer>> Renderer::Create(const Textures& textures, const WorldOptions& world,
                                                                 const RenderOptions& options) {
  CRAFTFLEET_RETURN_IF_ERROR(world.Validate());
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate(world));
  for (Sprite sprite = 0; sprite < kNumSprites; ++sprite) {
    const std::string name = SpriteName(sprite);
    if (IsPossible(world, sprite) && textures.Find(name) == nullptr) {
      return absl::NotFoundError(absl::StrCat("no texture ", textures.PathOf(name)));
    }
  }
  return std::shared_ptr<const Renderer>(new Renderer(textures, world, options));
}

Renderer::Renderer(const Textures& textures, const WorldOptions& world, const RenderOptions& options)
    : world_options_(world),
      layout_(world, options),
      strip_(textures, layout_),
      inventory_(options.inventory),
      tile_stride_((layout_.cell_height + kCopyGroup - 1) / kCopyGroup * kCopyGroup),
      tile_pixels_(layout_.cell_width * tile_stride_),
      tiles_(kNumSprites + 1),
      cover_(Vignette(layout_.map_width(), layout_.map_height())) {
  tiles_[kOutside].assign(tile_pixels_, kGrey);
  for (Sprite sprite = 0; sprite < kNumSprites; ++sprite) {
    const Texture* texture = textures.Find(SpriteName(sprite));
    if (texture == nullptr) continue;
    const Image image = Resize(*texture, layout_.cell_width, layout_.cell_height);
    tiles_[sprite].resize(tile_pixels_);
    for (int x = 0; x < image.width; ++x) {
      std::copy_n(image.pixels.begin() + x * image.height, image.height, tiles_[sprite].begin() + x * tile_stride_);
    }
  }
}

absl::Span<const Pixel> Renderer::Tile(Sprite sprite) const {
  CRAFTFLEET_CHECK(!tiles_[sprite].empty());
  return tiles_[sprite];
}

void Renderer::Render(const World& world, RandomStream* random, absl::Span<uint8_t> frame) const {
  CRAFTFLEET_CHECK(static_cast<int>(frame.size()) == frame_bytes());
  const bool noisy = world.daylight() < kNoiseBelow;
  absl::FixedArray<Pixel, kSmallMap> buffer(cover_.size() + kCopyGroup);
  PaintMap(world, !noisy, buffer.data());
  const absl::Span<Pixel> map(buffer.data(), cover_.size());
  if (noisy) {
    absl::FixedArray<double, kSmallMap> noise(map.size());
    random->FillUniform(absl::MakeSpan(noise));
    LightByNight(world.daylight(), noise, cover_, map);
  }
  if (world.player().sleeping) LightAsleep(map);
  std::memset(frame.data(), 0, frame.size());
  WriteMap(map.data(), frame.data());
  if (inventory_) strip_.Draw(world.player().inventory, frame);
}

void Renderer::PaintMap(const World& world, bool lit_by_day, Pixel* map) const {
  const size_t num_cells = layout_.columns * layout_.map_rows;
  absl::FixedArray<const Pixel*, kSmallView> cells(num_cells);
  // At most one for each of the ground's sprites in view and one for each object.
  absl::FixedArray<Pixel, 2 * kSmallView * kSmallTile> made_tiles(2 * num_cells * tile_pixels_);
  const Position player = world.player_position();
  MapView view = {world,
                  {player.x - layout_.columns / 2, player.y - layout_.map_rows / 2},
                  lit_by_day,
                  cells.data(),
                  made_tiles.data()};
  LayGround(&view);
  LayObjects(&view);
  for (int x = 0; x < layout_.columns; ++x) {
    for (int i = 0; i < layout_.cell_width; ++i) {
      // What a copy writes past its cell, the next one overwrites.
      for (int y = 0; y < layout_.map_rows; ++y, map += layout_.cell_height) {
        CopyColumn(cells[x * layout_.map_rows + y] + i * tile_stride_, layout_.cell_height, map);
      }
    }
  }
}

void Renderer::LayGround(MapView* view) const {
  std::array<const Pixel*, kNumSprites + 1> laid{};
  for (int x = 0; x < layout_.columns; ++x) {
    for (int y = 0; y < layout_.map_rows; ++y) {
      const Sprite sprite = GroundAt(view->world, view->corner + Position{x, y});
      const Pixel*& tile = laid[sprite];
      if (tile == nullptr) tile = view->lit_by_day ? MakeTile(Tile(sprite), {}, view) : Tile(sprite).data();
      view->cells[x * layout_.map_rows + y] = tile;
    }
  }
}

void Renderer::LayObjects(MapView* view) const {
  for (const Object& object : view->world.objects()) {
    const int x = object.position.x - view->corner.x;
    const int y = object.position.y - view->corner.y;
    if (x < 0 || x >= layout_.columns || y < 0 || y >= layout_.map_rows) continue;
    view->cells[x * layout_.map_rows + y] = MakeTile(Tile(GroundAt(view->world, object.position)),
                                                     Tile(SpriteOf(object, view->world.player().sleeping)), view);
  }
}

const Pixel* Renderer::MakeTile(absl::Span<const Pixel> ground, absl::Span<const Pixel> object, MapView* view) const {
  const absl::Span<Pixel> tile(view->free_tile, tile_pixels_);
  view->free_tile += tile_pixels_;
  std::copy(ground.begin(), ground.end(), tile.begin());
  if (!object.empty()) Blend(object, tile);
  if (view->lit_by_day) LightByDay(view->world.daylight(), tile);
  return tile.data();
}

void Renderer::WriteMap(const Pixel* map, uint8_t* frame) const {
  const int width = layout_.map_width();
  const int height = layout_.map_height();
  for (int y = 0; y < height; ++y) {
    uint8_t* row = frame + layout_.Offset(0, y);
    // The fourth byte, 0, falls on the next pixel: that of the map is still to be written, all others are black.
    for (int x = 0; x < width; ++x) std::memcpy(row + 3 * x, map + x * height + y, sizeof(Pixel));
  }
}

}  // namespace craftfleet
