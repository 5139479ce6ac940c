#include "envserver/render/png_texture.h"

#include <png.h>

#include <csetjmp>
#include <cstring>

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr absl::string_view kExpected = "want a PNG of 16x16 pixels, 8-bit RGB or RGBA";

absl::Status Refused(absl::string_view path, absl::string_view problem) {
  return absl::InvalidArgumentError(absl::StrCat("texture ", path, ": ", problem, ", ", kExpected));
}

// libpng's default handler would write to standard error.
[[noreturn]] void JumpOut(png_structp png, png_const_charp /*message*/) { png_longjmp(png, 1); }
void IgnoreWarning(png_structp /*png*/, png_const_charp /*message*/) {}

void TakeBytes(png_structp png, png_bytep out, size_t count) {
  auto* const bytes = static_cast<absl::string_view*>(png_get_io_ptr(png));
  if (bytes->size() < count) png_error(png, "the file ends early");
  std::memcpy(out, bytes->data(), count);
  bytes->remove_prefix(count);
}

// The header after the conversions below.
struct Header {
  png_uint_32 width = 0;
  png_uint_32 height = 0;
  int channels = 0;
  int depth = 0;  // bits a channel

  bool IsTexture() const {
    return width == kTextureSize && height == kTextureSize && depth == 8 && (channels == 3 || channels == 4);
  }
};

// libpng reports an error by a jump to the setjmp here, so that nothing in this function may need a destructor. False:
// not a complete PNG. Decodes the pixels only if the header is that of a texture.
bool Read(png_structp png, png_infop info, Header* header, Texture* texture) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_read_info(png, info);
  header->width = png_get_image_width(png, info);
  header->height = png_get_image_height(png, info);
  if (png_get_color_type(png, info) == PNG_COLOR_TYPE_PALETTE) png_set_expand(png);
  if (png_get_color_type(png, info) == PNG_COLOR_TYPE_GRAY_ALPHA) png_set_gray_to_rgb(png);
  const int passes = png_set_interlace_handling(png);
  png_read_update_info(png, info);
  header->channels = png_get_channels(png, info);
  header->depth = png_get_bit_depth(png, info);
  if (!header->IsTexture()) return true;
  uint8_t rows[kTextureSize][kTextureSize * 4];
  for (int pass = 0; pass < passes; ++pass) {
    for (auto& row : rows) png_read_row(png, row, nullptr);
  }
  png_read_end(png, nullptr);
  for (int y = 0; y < kTextureSize; ++y) {
    const uint8_t* rgb = rows[y];
    for (int x = 0; x < kTextureSize; ++x, rgb += header->channels) {
      const Pixel alpha = header->channels == 4 ? rgb[3] : 255;
      texture->pixels[y * kTextureSize + x] = rgb[0] | rgb[1] << 8 | rgb[2] << 16 | alpha << 24;
    }
  }
  return true;
}

}  // namespace

absl::StatusOr<Texture> DecodeTexture(absl::string_view bytes, absl::string_view path) {
  Header header;
  Texture texture;
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, nullptr, JumpOut, IgnoreWarning);
  png_infop info = png == nullptr ? nullptr : png_create_info_struct(png);
  bool complete = false;
  if (info != nullptr) {
    png_set_read_fn(png, &bytes, TakeBytes);
    complete = Read(png, info, &header, &texture);
  }
  png_destroy_read_struct(&png, &info, nullptr);
  if (!complete) return Refused(path, "unreadable");
  if (header.depth != 8 || (header.channels != 3 && header.channels != 4)) {
    return Refused(path, absl::StrCat(header.channels, " channels of ", header.depth, " bits"));
  }
  if (!header.IsTexture()) return Refused(path, absl::StrCat(header.width, "x", header.height, " pixels"));
  return texture;
}

}  // namespace craftfleet
