#include "envserver/render/renderer.h"

#include <algorithm>
#include <array>
#include <cstring>

#include <absl/container/fixed_array.h>
#include <absl/strings/str_cat.h>

#include "common/check.h"
#include "common/crafter.h"
#include "common/multiversion.h"
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
constexpr int kSmallMap = 63 * 49 + kCopyGroup;
constexpr int kSmallView = 9 * 7;
constexpr int kSmallTile = 7 * 8;

// Copies `count` pixels and up to kCopyGroup - 1 more: fixed-size moves take a third of the time of exact ones.
void CopyColumn(const Pixel* from, int count, Pixel* to) {
  for (int i = 0; i < count; i += kCopyGroup) std::memcpy(to + i, from + i, kCopyGroup * sizeof(Pixel));
}

}  // namespace

absl::StatusOr<std::shared_ptr<const Renderer>> Renderer::Create(const Textures& textures, const WorldOptions& world,
                                                                 const RenderOptions& options) {
  CRAFTFLEET_RETURN_IF_ERROR(world.Validate());
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate(world));
  for (const Sprite sprite : SpritesInUse(world)) {
    const std::string name = SpriteName(sprite);
    if (textures.Find(name) == nullptr) return absl::NotFoundError(absl::StrCat("no texture ", textures.PathOf(name)));
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
  for (const Sprite sprite : SpritesInUse(world)) {
    const Image image = Resize(*textures.Find(SpriteName(sprite)), layout_.cell_width, layout_.cell_height);
    tiles_[sprite].resize(tile_pixels_);
    for (int x = 0; x < image.width; ++x) {
      std::copy_n(image.pixels.begin() + x * image.height, image.height, tiles_[sprite].begin() + x * tile_stride_);
    }
  }
}

void Renderer::Render(const World& world, RandomStream* random, absl::Span<uint8_t> frame) const {
  CRAFTFLEET_CHECK(static_cast<int>(frame.size()) == frame_bytes());
  const size_t map_pixels = cover_.size();
  const bool noisy = world.daylight() < kNoiseBelow;
  absl::FixedArray<Pixel, kSmallMap> buffer(map_pixels + kCopyGroup);
  const absl::Span<Pixel> map(buffer.data(), map_pixels);
  PaintMap(world, !noisy, absl::MakeSpan(buffer));
  if (noisy) {
    absl::FixedArray<double, kSmallMap> noise(map_pixels);
    random->FillUniform(absl::MakeSpan(noise));
    LightByNight(world.daylight(), noise, cover_, map);
  }
  if (world.player().sleeping) LightAsleep(map);
  std::memset(frame.data(), 0, frame.size());
  WriteMap(map.data(), frame.data());
  if (inventory_) strip_.Draw(world.player().inventory, frame);
}

void Renderer::PaintMap(const World& world, bool lit_by_day, absl::Span<Pixel> map) const {
  const int num_cells = layout_.columns * layout_.map_rows;
  // Tiles made for this picture: one for each object, and by day one for each of the ground's sprites.
  absl::FixedArray<Pixel, 2 * kSmallView * kSmallTile> made(static_cast<size_t>(2 * num_cells) * tile_pixels_);
  absl::FixedArray<const Pixel*, kSmallView> cells(num_cells);
  std::array<const Pixel*, kNumSprites + 1> ground{};
  Pixel* free_tile = made.data();
  const auto finish = [&](absl::Span<Pixel> tile) {
    if (lit_by_day) LightByDay(world.daylight(), tile);
    free_tile += tile_pixels_;
    return tile.data();
  };

  const Position corner = {world.player_position().x - layout_.columns / 2,
                           world.player_position().y - layout_.map_rows / 2};
  const auto sprite_at = [&](Position p) {
    const Material material = world.material(p);
    return material == Material::kNone ? kOutside : SpriteOf(material, world.variant(p));
  };
  for (int x = 0; x < layout_.columns; ++x) {
    for (int y = 0; y < layout_.map_rows; ++y) {
      const Sprite sprite = sprite_at(corner + Position{x, y});
      const Pixel*& tile = ground[sprite];
      if (tile == nullptr) {
        tile = tiles_[sprite].data();
        if (lit_by_day) {
          std::copy_n(tile, tile_pixels_, free_tile);
          tile = finish({free_tile, static_cast<size_t>(tile_pixels_)});
        }
      }
      cells[x * layout_.map_rows + y] = tile;
    }
  }
  for (const Object& object : world.objects()) {
    const int x = object.position.x - corner.x;
    const int y = object.position.y - corner.y;
    if (x < 0 || x >= layout_.columns || y < 0 || y >= layout_.map_rows) continue;
    const absl::Span<Pixel> tile(free_tile, tile_pixels_);
    std::copy_n(tiles_[sprite_at(object.position)].data(), tile_pixels_, free_tile);
    Blend(tiles_[SpriteOf(object, world.player().sleeping)], tile);
    cells[x * layout_.map_rows + y] = finish(tile);
  }
  Pixel* column = map.data();
  for (int x = 0; x < layout_.columns; ++x) {
    for (int i = 0; i < layout_.cell_width; ++i) {
      // What a copy writes past its cell, the next one overwrites.
      for (int y = 0; y < layout_.map_rows; ++y, column += layout_.cell_height) {
        CopyColumn(cells[x * layout_.map_rows + y] + i * tile_stride_, layout_.cell_height, column);
      }
    }
  }
}

void Renderer::WriteMap(const Pixel* map, uint8_t* frame) const {
  const int width = layout_.map_width();
  const int height = layout_.map_height();
  for (int y = 0; y < height; ++y) {
    uint8_t* row = frame + layout_.Offset(0, y);
    // The fourth byte, 0, falls on the next pixel: written after this one, or black like every border, or the strip's.
    for (int x = 0; x < width; ++x) std::memcpy(row + 3 * x, map + x * height + y, sizeof(Pixel));
  }
}

}  // namespace craftfleet
