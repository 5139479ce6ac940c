#include "common/io/png_encoder.h"

#include <png.h>
#include <zlib.h>

#include <csetjmp>

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr int kMaxSide = 1000000;  // PNG_USER_WIDTH_MAX and PNG_USER_HEIGHT_MAX

// libpng's own would write to standard error.
[[noreturn]] void JumpOut(png_structp png, png_const_charp /*message*/) { png_longjmp(png, 1); }
void IgnoreWarning(png_structp /*png*/, png_const_charp /*message*/) {}

void AppendBytes(png_structp png, png_bytep bytes, size_t count) {
  static_cast<std::string*>(png_get_io_ptr(png))->append(reinterpret_cast<const char*>(bytes), count);
}
void FlushNothing(png_structp /*png*/) {}

// libpng reports an error by a jump to the setjmp here, so nothing in this function may need a destructor. False:
// libpng failed.
bool Write(png_structp png, png_infop info, absl::string_view pixels, int width, int height) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_set_compression_mem_level(png, MAX_MEM_LEVEL);
  png_set_compression_level(png, Z_BEST_SPEED);
  png_set_compression_strategy(png, Z_RLE);
  png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  png_set_IHDR(png, info, width, height, 8, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  for (int y = 0; y < height; ++y) {
    png_write_row(png, reinterpret_cast<png_const_bytep>(pixels.data()) + size_t{3} * width * y);
  }
  png_write_end(png, info);
  return true;
}

}  // namespace

absl::StatusOr<std::string> EncodePng(absl::string_view pixels, int width, int height) {
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide || pixels.size() != size_t{3} * width * height) {
    return absl::InvalidArgumentError(absl::StrCat("picture of ", width, "x", height, " pixels in ", pixels.size(),
                                                   " bytes, want 1 to ", kMaxSide, " a side and 3 bytes a pixel"));
  }
  std::string file;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, JumpOut, IgnoreWarning);
  png_infop info = png == nullptr ? nullptr : png_create_info_struct(png);
  bool complete = false;
  if (info != nullptr) {
    png_set_write_fn(png, &file, AppendBytes, FlushNothing);
    complete = Write(png, info, pixels, width, height);
  }
  png_destroy_write_struct(&png, &info);
  if (!complete) return absl::InternalError("libpng could not encode the picture");
  return file;
}

}  // namespace craftfleet
