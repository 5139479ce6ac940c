#include "envserver/render/inventory_strip.h"

#include <cstring>

#include <absl/strings/str_cat.h>

#include "envserver/render/image.h"

namespace craftfleet {
namespace {

// The offset of a part at `share` of a cell from the edge of the cell with this number.
int Inset(int cell, int cell_size, double share) {
  return static_cast<int>(cell * cell_size + share * cell_size) - cell * cell_size;
}

Image Scaled(const Texture& texture, const PictureLayout& layout, double share) {
  return Resize(texture, static_cast<int>(share * layout.cell_width), static_cast<int>(share * layout.cell_height));
}

void DrawAt(const Image& image, int x, int y, Image* canvas) {
  for (int column = 0; column < image.width; ++column) {
    Blend(absl::MakeConstSpan(image.pixels).subspan(column * image.height, image.height),
          absl::MakeSpan(canvas->pixels).subspan((x + column) * canvas->height + y, image.height));
  }
}

// Copies a row of a cell. For the usual size, two overlapping copies of fixed size are faster than a call of memcpy.
void CopyRow(const uint8_t* from, int bytes, uint8_t* to) {
  constexpr int kHalf = 16;
  if (bytes >= kHalf && bytes <= 2 * kHalf) {
    std::memcpy(to, from, kHalf);
    std::memcpy(to + bytes - kHalf, from + bytes - kHalf, kHalf);
  } else {
    std::memcpy(to, from, bytes);
  }
}

}  // namespace

InventoryStrip::InventoryStrip(const Textures& textures, const PictureLayout& layout)
    : layout_(layout), cell_bytes_(layout.cell_width * layout.cell_height * 3) {
  std::array<Image, kMaxItem> digits;
  for (int digit = 1; digit <= kMaxItem; ++digit) {
    digits[digit - 1] = Scaled(*textures.Find(absl::StrCat(digit)), layout, 0.6);
  }
  cells_.reserve(kNumItems * kMaxItem * cell_bytes_);
  for (int item = 0; item < kNumItems; ++item) {
    const int column = item % layout.columns;
    const int row = item / layout.columns;
    Image with_icon{layout.cell_width, layout.cell_height, {}};
    with_icon.pixels.resize(layout.cell_width * layout.cell_height);
    DrawAt(Scaled(*textures.Find(kItemNames[item]), layout, 0.8), Inset(column, layout.cell_width, 0.1),
           Inset(row, layout.cell_height, 0.1), &with_icon);
    for (const Image& digit : digits) {
      Image cell = with_icon;
      DrawAt(digit, Inset(column, layout.cell_width, 0.4), Inset(row, layout.cell_height, 0.4), &cell);
      for (int y = 0; y < cell.height; ++y) {
        for (int x = 0; x < cell.width; ++x) {
          const Pixel pixel = cell.at(x, y);
          cells_.insert(cells_.end(), {static_cast<uint8_t>(pixel), static_cast<uint8_t>(pixel >> 8),
                                       static_cast<uint8_t>(pixel >> 16)});
        }
      }
    }
  }
}

void InventoryStrip::Draw(const std::array<int8_t, kNumItems>& inventory, absl::Span<uint8_t> frame) const {
  const int row_bytes = layout_.cell_width * 3;
  for (int item = 0; item < kNumItems; ++item) {
    if (inventory[item] < 1) continue;
    const uint8_t* cell = CellOf(item, inventory[item]);
    const int x = item % layout_.columns * layout_.cell_width;
    const int y = layout_.map_height() + item / layout_.columns * layout_.cell_height;
    for (int row = 0; row < layout_.cell_height; ++row, cell += row_bytes) {
      CopyRow(cell, row_bytes, frame.data() + layout_.Offset(x, y + row));
    }
  }
}

}  // namespace craftfleet
