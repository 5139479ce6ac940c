#include "envserver/render/renderer.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <string>

#include <absl/container/fixed_array.h>
#include <absl/strings/str_cat.h>

#include "common/base/check.h"
#include "common/base/cpu_path.h"
#include "common/base/status_macros.h"
#include "envserver/render/image.h"
#include "envserver/render/rows.h"
#include "envserver/render/vignette.h"

namespace craftfleet {
namespace {

constexpr Pixel kGrey = 127 | 127 << 8 | 127 << 16;

// A tile by number: the sprites, then the outside, then tiles made for the picture, each a thing on its ground.
constexpr int kFirstMade = kOutside + 1;

// Copies are made in groups of a fixed size, which takes a third of the time of exact ones.
constexpr int kPixelGroup = 8;
constexpr int kByteGroup = 32;

// Buffers up to these sizes are on the stack: enough for 64x64 pictures.
constexpr int kSmallView = Scene::kSmallView;
constexpr int kSmallTile = 7 * 8;
constexpr int kSmallRgbTile = 7 * 32;
constexpr int kSmallMap = 63 * 49 + kNightBlock + kPixelGroup;

int RoundUp(int value, int multiple) { return (value + multiple - 1) / multiple * multiple; }

// Writes the ground of a column of the view whose upper end is `top`.
void CaptureColumn(const World& world, Position top, int rows, uint8_t* ground) {
  const int width = world.options().width;
  const int height = world.options().height;
  std::memset(ground, kOutside, rows);
  if (top.x < 0 || top.x >= width) return;
  const absl::Span<const BoardCell> cells = world.column(top.x);
  const int end = std::min(rows, height - top.y);
  for (int y = std::max(0, -top.y); y < end; ++y) {
    const BoardCell& cell = cells[top.y + y];
    if (cell.material != Material::kNone) ground[y] = SpriteOf(cell.material, cell.variant);
  }
}

// Copies `count` elements and the rest of the last group.
template <int kGroup, typename T>
CRAFTFLEET_KERNEL_BODY void CopyGroups(const T* from, int count, T* to) {
  for (int i = 0; i < count; i += kGroup) std::memcpy(to + i, from + i, kGroup * sizeof(T));
}

// How tiles are laid in columns, in pixels but for the first two.
struct CellLayout {
  int columns;  // of cells
  int rows;     // of cells
  int cell_width;
  int cell_height;
  int tile_stride;
};

// Lays the tiles of [columns][rows] cells. Each copy overwrites what the one before wrote past its cell.
template <int kGroups>
CRAFTFLEET_KERNEL_BODY void LayCellsLoop(const Pixel* const* cells, CellLayout layout, Pixel* canvas) {
  for (int column = 0; column < layout.columns; ++column, cells += layout.rows) {
    for (int x = 0; x < layout.cell_width; ++x) {
      for (int row = 0; row < layout.rows; ++row, canvas += layout.cell_height) {
        const Pixel* from = cells[row] + x * layout.tile_stride;
        CopyGroups<kPixelGroup>(from, kGroups > 0 ? kGroups * kPixelGroup : layout.cell_height, canvas);
      }
    }
  }
}
CRAFTFLEET_KERNEL(LayCells, LayCellsLoop<0>)
CRAFTFLEET_KERNEL(LaySmallCells, LayCellsLoop<1>)

// How finished tiles are copied to a frame. Lengths in bytes but for the first three.
struct CellCopy {
  int columns;      // of cells
  int rows;         // of cells
  int cell_height;  // rows of pixels
  int cell_bytes;   // of a row of a cell
  int tile_stride;
  int frame_stride;
};

// Copies the tiles of [columns][rows] cells. Each copy overwrites what the one before wrote past its cell; past the
// last cell of a row it is black.
template <int kGroups>
CRAFTFLEET_KERNEL_BODY void CopyCellsLoop(const uint8_t* const* cells, CellCopy copy, uint8_t* frame) {
  for (int row = 0; row < copy.rows; ++row) {
    for (int y = 0; y < copy.cell_height; ++y, frame += copy.frame_stride) {
      uint8_t* to = frame;
      for (int column = 0; column < copy.columns; ++column, to += copy.cell_bytes) {
        const uint8_t* from = cells[column * copy.rows + row] + y * copy.tile_stride;
        CopyGroups<kByteGroup>(from, kGroups > 0 ? kGroups * kByteGroup : copy.cell_bytes, to);
      }
    }
  }
}
CRAFTFLEET_KERNEL(CopyCells, CopyCellsLoop<0>)
CRAFTFLEET_KERNEL(CopySmallCells, CopyCellsLoop<1>)

}  // namespace

// The tiles in the cells of the view.
struct Renderer::Tiles {
  Tiles(const Scene& scene, int tile_pixels)
      : numbers(scene.ground.begin(), scene.ground.end()), made(numbers.size() * tile_pixels) {}

  absl::FixedArray<int, kSmallView> numbers;              // [columns][map_rows]
  absl::FixedArray<Pixel, kSmallView * kSmallTile> made;  // the tiles from kFirstMade on
  int num_made = 0;
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
      tile_stride_(RoundUp(layout_.cell_height, kPixelGroup)),
      tile_pixels_(layout_.cell_width * tile_stride_),
      rgb_stride_(RoundUp(layout_.cell_width * 3 + 1, kByteGroup)),
      tiles_(kNumSprites + 1),
      cover_(Vignette(layout_.map_width(), layout_.map_height())) {
  cover_.resize(RoundUp(static_cast<int>(cover_.size()), kNightBlock));
  float_cover_.assign(cover_.begin(), cover_.end());
  tiles_[kOutside].assign(tile_pixels_, kGrey);
  for (Sprite sprite = 0; sprite < kNumSprites; ++sprite) {
    possible_[sprite] = IsPossible(world, sprite);
    const Texture* texture = textures.Find(SpriteName(sprite));
    if (texture == nullptr) continue;
    const Image image = Resize(*texture, layout_.cell_width, layout_.cell_height);
    tiles_[sprite].resize(tile_pixels_);
    for (int x = 0; x < image.width; ++x) {
      std::copy_n(image.pixels.begin() + x * image.height, image.height, tiles_[sprite].begin() + x * tile_stride_);
    }
  }
}

void Renderer::Render(const World& world, RandomStream* random, absl::Span<uint8_t> frame) const {
  Scene scene;
  Capture(world, &scene);
  Render(scene, random, frame);
}

void Renderer::Capture(const World& world, Scene* scene) const {
  const Position player = world.player_position();
  // The cell in the upper left corner of the view; it may be outside the world.
  const Position corner = {player.x - layout_.columns / 2, player.y - layout_.map_rows / 2};
  scene->ground.resize(num_cells());
  uint8_t* ground = scene->ground.data();
  for (int x = 0; x < layout_.columns; ++x) {
    CaptureColumn(world, corner + Position{x, 0}, layout_.map_rows, ground + x * layout_.map_rows);
  }
  scene->sleeping = world.player().sleeping;
  scene->things.clear();
  for (const Object& object : world.objects()) {
    const int x = object.position.x - corner.x;
    const int y = object.position.y - corner.y;
    if (x < 0 || x >= layout_.columns || y < 0 || y >= layout_.map_rows) continue;
    scene->things.push_back(
        {static_cast<uint16_t>(x * layout_.map_rows + y), static_cast<uint8_t>(SpriteOf(object, scene->sleeping))});
  }
  std::sort(scene->things.begin(), scene->things.end(), [](Scene::Thing a, Scene::Thing b) { return a.cell < b.cell; });
  scene->inventory = world.player().inventory;
  scene->daylight = world.daylight();
}

void Renderer::Render(const Scene& scene, RandomStream* random, absl::Span<uint8_t> frame) const {
  CRAFTFLEET_CHECK(static_cast<int>(frame.size()) == frame_bytes());
  Tiles tiles(scene, tile_pixels_);
  LayThings(scene, &tiles);
  std::memset(frame.data(), 0, frame.size());
  if (scene.is_dark()) {
    DrawMapByNight(scene, tiles, random, frame.data());
  } else {
    DrawMapByDay(scene, tiles, frame.data());
  }
  if (inventory_) strip_.Draw(scene.inventory, frame);
}

const Pixel* Renderer::Tile(const Tiles& tiles, int tile) const {
  if (tile >= kFirstMade) return tiles.made.data() + (tile - kFirstMade) * tile_pixels_;
  CRAFTFLEET_CHECK(!tiles_[tile].empty());
  return tiles_[tile].data();
}

void Renderer::LayThings(const Scene& scene, Tiles* tiles) const {
  for (const Scene::Thing& thing : scene.things) {
    int& tile = tiles->numbers[thing.cell];
    Pixel* made = tiles->made.data() + tiles->num_made * tile_pixels_;
    std::copy_n(Tile(*tiles, tile), tile_pixels_, made);
    const Pixel* sprite = Tile(*tiles, thing.sprite);
    Blend(absl::MakeConstSpan(sprite, tile_pixels_), absl::MakeSpan(made, tile_pixels_));
    tile = kFirstMade + tiles->num_made++;
  }
}

void Renderer::DrawMapByNight(const Scene& scene, const Tiles& tiles, RandomStream* random, uint8_t* frame) const {
  absl::FixedArray<const Pixel*, kSmallView> cells(tiles.numbers.size());
  for (size_t i = 0; i < cells.size(); ++i) cells[i] = Tile(tiles, tiles.numbers[i]);
  const int map_pixels = layout_.map_width() * layout_.map_height();
  const auto blocks = cover_.size();  // of whole blocks of pixels
  absl::FixedArray<Pixel, kSmallMap> canvas(blocks + kPixelGroup);
  const CellLayout layout = {layout_.columns, layout_.map_rows, layout_.cell_width, layout_.cell_height, tile_stride_};
  if (layout_.cell_height <= kPixelGroup) {
    LaySmallCells(cells.data(), layout, canvas.data());
  } else {
    LayCells(cells.data(), layout, canvas.data());
  }
  absl::FixedArray<uint32_t, kSmallMap> high(blocks);
  absl::FixedArray<uint32_t, kSmallMap> low(blocks);
  random->FillWords(absl::MakeSpan(high).first(map_pixels), absl::MakeSpan(low).first(map_pixels));
  absl::FixedArray<Pixel, kSmallMap> lit(blocks);
  std::fill(canvas.begin() + map_pixels, canvas.end(), 0);
  std::fill(high.begin() + map_pixels, high.end(), 0);
  std::fill(low.begin() + map_pixels, low.end(), 0);
  LightByNight(scene.daylight,
               {high, low, cover_, float_cover_, absl::MakeSpan(canvas).first(blocks), absl::MakeSpan(lit)});
  const absl::Span<Pixel> map = absl::MakeSpan(lit).first(map_pixels);
  if (scene.sleeping) LightAsleep(map);
  WriteRows(map.data(), layout_.map_height(), layout_.map_width(), layout_.map_height(), frame + layout_.Offset(0, 0),
            layout_.width * 3);
}

void Renderer::DrawMapByDay(const Scene& scene, const Tiles& tiles, uint8_t* frame) const {
  const int rgb_tile_bytes = layout_.cell_height * rgb_stride_;
  absl::FixedArray<uint8_t, kSmallView * kSmallRgbTile> finished(tiles.numbers.size() * rgb_tile_bytes);
  absl::FixedArray<const uint8_t*, kFirstMade + kSmallView> rgb_of_tile(kFirstMade + tiles.num_made, nullptr);
  absl::FixedArray<const uint8_t*, kSmallView> cells(tiles.numbers.size());
  uint8_t* free_rgb = finished.data();
  for (size_t i = 0; i < cells.size(); ++i) {
    const uint8_t*& rgb = rgb_of_tile[tiles.numbers[i]];
    if (rgb == nullptr) {
      rgb = free_rgb;
      FinishTile(scene, Tile(tiles, tiles.numbers[i]), free_rgb);
      free_rgb += rgb_tile_bytes;
    }
    cells[i] = rgb;
  }
  const CellCopy copy = {layout_.columns,        layout_.map_rows, layout_.cell_height,
                         layout_.cell_width * 3, rgb_stride_,      layout_.width * 3};
  uint8_t* map = frame + layout_.Offset(0, 0);
  if (copy.cell_bytes <= kByteGroup) {
    CopySmallCells(cells.data(), copy, map);
  } else {
    CopyCells(cells.data(), copy, map);
  }
}

void Renderer::FinishTile(const Scene& scene, const Pixel* tile, uint8_t* rgb) const {
  absl::FixedArray<Pixel, kSmallTile> lit(tile, tile + tile_pixels_);
  LightByDay(scene.daylight, absl::MakeSpan(lit));
  if (scene.sleeping) LightAsleep(absl::MakeSpan(lit));
  for (int i = 0; i < layout_.cell_height * rgb_stride_; i += kByteGroup) std::memset(rgb + i, 0, kByteGroup);
  WriteRows(lit.data(), tile_stride_, layout_.cell_width, layout_.cell_height, rgb, rgb_stride_);
}

}  // namespace craftfleet
