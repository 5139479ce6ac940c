#include "tests/envserver/render/plain_renderer.h"

#include <array>
#include <string>

#include <absl/strings/str_cat.h>

#include "envserver/render/image.h"
#include "envserver/render/sprites.h"
#include "envserver/render/vignette.h"

namespace craftfleet {
namespace {

using Rgb = std::array<int, 3>;

// A picture that is being drawn.
struct Canvas {
  Canvas(int canvas_width, int canvas_height, Rgb color)
      : width(canvas_width), height(canvas_height), pixels(canvas_width * canvas_height, color) {}

  Rgb& at(int x, int y) { return pixels[y * width + x]; }

  // Draws a texture with its alpha, or without if `opaque`.
  void Draw(const Image& image, int left, int top, bool opaque) {
    for (int x = 0; x < image.width; ++x) {
      for (int y = 0; y < image.height; ++y) {
        for (int k = 0; k < 3; ++k) {
          const int over = image.at(x, y) >> 8 * k & 255;
          int& under = at(left + x, top + y)[k];
          const float alpha = static_cast<float>(image.at(x, y) >> 24) / 255.0f;
          const float top_part = alpha * (static_cast<float>(over) / 255.0f);
          const float under_part = (1.0f - alpha) * (static_cast<float>(under) / 255.0f);
          under = opaque ? over : static_cast<int>(255.0f * (top_part + under_part));
        }
      }
    }
  }

  int width;
  int height;
  std::vector<Rgb> pixels;
};

int Luma(Rgb c) { return (19595 * c[0] + 38470 * c[1] + 7471 * c[2] + 32768) >> 16; }

// `cover` is the vignette at the pixel, `noise` its draw; both are used only below half daylight.
Rgb Lit(Rgb canvas, double daylight, double cover, double noise, bool sleeping) {
  Rgb night = canvas;
  if (daylight < 0.5) {
    const double covered = 2 * (0.5 - daylight) * cover;
    for (int& v : night) v = static_cast<int>((1 - covered) * v + covered * (32 + 95 * noise));
  }
  const int luma = Luma(night);
  const Rgb tint = {0, 16, 64};
  Rgb lit;
  for (int k = 0; k < 3; ++k) {
    const float part = 0.4f * static_cast<float>(night[k] - luma);
    const int dim = static_cast<int>(static_cast<float>(luma) + part);
    const double dark = 0.5 * dim + 0.5 * tint[k];
    lit[k] = static_cast<int>(daylight * canvas[k] + (1 - daylight) * dark);
  }
  if (!sleeping) return lit;
  const double half = 0.5 * Luma(lit);
  return {static_cast<int>(half), static_cast<int>(half), static_cast<int>(half + 0.5 * 16)};
}

void DrawMap(const Textures& textures, const World& world, const PictureLayout& layout, Canvas* map) {
  const Position player = world.player_position();
  const auto draw = [&](Sprite sprite, int x, int y, bool opaque) {
    const Image image = Resize(*textures.Find(SpriteName(sprite)), layout.cell_width, layout.cell_height);
    map->Draw(image, x * layout.cell_width, y * layout.cell_height, opaque);
  };
  for (int x = 0; x < layout.columns; ++x) {
    for (int y = 0; y < layout.map_rows; ++y) {
      const Position p = player + Position{x - layout.columns / 2, y - layout.map_rows / 2};
      if (world.material(p) != Material::kNone) draw(SpriteOf(world.material(p), world.variant(p)), x, y, true);
    }
  }
  for (const Object& object : world.objects()) {
    const int x = object.position.x - player.x + layout.columns / 2;
    const int y = object.position.y - player.y + layout.map_rows / 2;
    if (x < 0 || x >= layout.columns || y < 0 || y >= layout.map_rows) continue;
    draw(SpriteOf(object, world.player().sleeping), x, y, false);
  }
}

void DrawItems(const Textures& textures, const World& world, const PictureLayout& layout, Canvas* strip) {
  const auto draw = [&](absl::string_view name, int item, double share, double inset) {
    const int column = item % layout.columns;
    const int row = item / layout.columns;
    const Image image = Resize(*textures.Find(name), static_cast<int>(share * layout.cell_width),
                               static_cast<int>(share * layout.cell_height));
    strip->Draw(image, static_cast<int>(column * layout.cell_width + inset * layout.cell_width),
                static_cast<int>(row * layout.cell_height + inset * layout.cell_height), false);
  };
  for (int item = 0; item < kNumItems; ++item) {
    const int amount = world.player().item(static_cast<Item>(item));
    if (amount < 1) continue;
    draw(kItemNames[item], item, 0.8, 0.1);
    draw(absl::StrCat(amount), item, 0.6, 0.4);
  }
}

}  // namespace

std::vector<uint8_t> PlainPicture(const Textures& textures, const World& world, const RenderOptions& options,
                                  RandomStream* random) {
  const PictureLayout layout(world.options(), options);
  Canvas map(layout.map_width(), layout.map_height(), {127, 127, 127});
  DrawMap(textures, world, layout, &map);
  const std::vector<double> cover = Vignette(map.width, map.height);
  for (int x = 0; x < map.width; ++x) {
    for (int y = 0; y < map.height; ++y) {
      const double noise = world.daylight() < 0.5 ? random->Uniform() : 0;
      map.at(x, y) = Lit(map.at(x, y), world.daylight(), cover[x * map.height + y], noise, world.player().sleeping);
    }
  }
  Canvas strip(map.width, layout.item_rows * layout.cell_height, {0, 0, 0});
  if (options.inventory) DrawItems(textures, world, layout, &strip);

  std::vector<uint8_t> frame(options.width * options.height * 3, 0);
  for (int y = 0; y < map.height + strip.height; ++y) {
    for (int x = 0; x < map.width; ++x) {
      const Rgb color = y < map.height ? map.at(x, y) : strip.at(x, y - map.height);
      const int offset = ((layout.border_top + y) * options.width + layout.border_left + x) * 3;
      for (int k = 0; k < 3; ++k) frame[offset + k] = static_cast<uint8_t>(color[k]);
    }
  }
  return frame;
}

}  // namespace craftfleet
