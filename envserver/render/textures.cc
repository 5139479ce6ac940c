#include "envserver/render/textures.h"

#include <png.h>

#include <algorithm>
#include <csetjmp>
#include <cstring>

#include <absl/strings/str_cat.h>

#include "common/check.h"
#include "common/crafter.h"
#include "common/files.h"
#include "common/status_macros.h"
#include "envserver/render/sprites.h"
#include "envserver/world/state.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kWanted = "want a PNG of 16x16 pixels, 8-bit RGB or RGBA";

absl::Status Refused(absl::string_view path, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("texture ", path, ": ", what, ", ", kWanted));
}

// What a PNG's first bytes say; all 0 when there is no picture.
struct PngHeader {
  int width = 0, height = 0;  // pixels
  int channels = 0;           // a palette counts as the colours that it has
  int bits = 0;               // a channel
};

// Reads PNG from memory. libpng reports errors by longjmp: between setjmp and its last call there is nothing to
// destroy. Colours are taken as they stand: profiles and gamma in the file change nothing.
class PngReader {
 public:
  explicit PngReader(absl::string_view bytes)
      : rest_(bytes),
        png_(png_create_read_struct(PNG_LIBPNG_VER_STRING, /*error_ptr=*/nullptr, OnError, OnWarning)),
        info_(png_create_info_struct(png_)) {
    CRAFTFLEET_CHECK(info_ != nullptr);
    png_set_read_fn(png_, this, Read);
  }
  ~PngReader() { png_destroy_read_struct(&png_, &info_, /*end_info_ptr_ptr=*/nullptr); }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;

  PngHeader ReadHeader() {
    if (setjmp(png_jmpbuf(png_)) != 0) return {};
    png_read_info(png_, info_);
    if (png_get_color_type(png_, info_) == PNG_COLOR_TYPE_PALETTE) png_set_expand(png_);
    png_set_interlace_handling(png_);
    png_read_update_info(png_, info_);
    return {static_cast<int>(png_get_image_width(png_, info_)), static_cast<int>(png_get_image_height(png_, info_)),
            png_get_channels(png_, info_), png_get_bit_depth(png_, info_)};
  }
  // After ReadHeader. `rows`: one pointer for each row. False: the file is cut off or spoilt.
  bool ReadRows(png_bytepp rows) {
    if (setjmp(png_jmpbuf(png_)) != 0) return false;
    png_read_image(png_, rows);
    png_read_end(png_, nullptr);
    return true;
  }

 private:
  [[noreturn]] static void OnError(png_structp png, png_const_charp /*message*/) { png_longjmp(png, 1); }
  static void OnWarning(png_structp /*png*/, png_const_charp /*message*/) {}
  static void Read(png_structp png, png_bytep out, size_t count) {
    absl::string_view& rest = static_cast<PngReader*>(png_get_io_ptr(png))->rest_;
    if (count > rest.size()) png_error(png, "cut off");
    std::memcpy(out, rest.data(), count);
    rest.remove_prefix(count);
  }

  absl::string_view rest_;
  png_structp png_;
  png_infop info_;
};

}  // namespace

absl::StatusOr<Texture> DecodeTexture(absl::string_view bytes, absl::string_view path) {
  PngReader png(bytes);
  const PngHeader header = png.ReadHeader();
  if (header.channels == 0) return Refused(path, "unreadable");
  if (header.bits != 8 || (header.channels != 3 && header.channels != 4)) {
    return Refused(path, absl::StrCat(header.channels, " channels of ", header.bits, " bits"));
  }
  if (header.width != kTextureSize || header.height != kTextureSize) {
    return Refused(path, absl::StrCat(header.width, "x", header.height, " pixels"));
  }
  std::array<std::array<png_byte, kTextureSize * 4>, kTextureSize> image;
  std::array<png_bytep, kTextureSize> rows;
  std::transform(image.begin(), image.end(), rows.begin(), [](auto& row) { return row.data(); });
  if (!png.ReadRows(rows.data())) return Refused(path, "unreadable");
  Texture texture;
  for (int y = 0; y < kTextureSize; ++y) {
    const png_byte* rgb = image[y].data();
    for (int x = 0; x < kTextureSize; ++x, rgb += header.channels) {
      const Pixel alpha = header.channels == 4 ? rgb[3] : 255;
      texture.pixels[y * kTextureSize + x] = rgb[0] | rgb[1] << 8 | rgb[2] << 16 | alpha << 24;
    }
  }
  return texture;
}

absl::StatusOr<std::shared_ptr<const Textures>> Textures::Load(const std::string& folder) {
  auto textures = std::make_shared<Textures>();
  textures->folder_ = folder;
  const auto load = [&](const std::string& name) -> absl::Status {
    const std::string path = textures->PathOf(name);
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path));
    CRAFTFLEET_ASSIGN_OR_RETURN(textures->textures_[name], DecodeTexture(bytes, path));
    return absl::OkStatus();
  };
  for (Sprite sprite = 0; sprite < kNumSprites; ++sprite) {
    const std::string name = SpriteName(sprite);
    if (IsVariant(sprite) && !PathExists(textures->PathOf(name))) continue;
    CRAFTFLEET_RETURN_IF_ERROR(load(name));
  }
  for (const absl::string_view item : kItemNames) CRAFTFLEET_RETURN_IF_ERROR(load(std::string(item)));
  for (int digit = 1; digit <= kMaxItem; ++digit) CRAFTFLEET_RETURN_IF_ERROR(load(absl::StrCat(digit)));
  return textures;
}

const Texture* Textures::Find(absl::string_view name) const {
  const auto found = textures_.find(name);
  return found == textures_.end() ? nullptr : &found->second;
}

std::string Textures::PathOf(absl::string_view name) const { return JoinPath(folder_, absl::StrCat(name, ".png")); }

}  // namespace craftfleet
