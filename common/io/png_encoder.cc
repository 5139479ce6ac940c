#include "common/io/png_encoder.h"

#include <png.h>

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr int kMaxSide = 1000000;  // PNG_USER_WIDTH_MAX and PNG_USER_HEIGHT_MAX

}  // namespace

absl::StatusOr<std::string> EncodePng(absl::string_view pixels, int width, int height) {
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide || pixels.size() != size_t{3} * width * height) {
    return absl::InvalidArgumentError(absl::StrCat("picture of ", width, "x", height, " pixels in ", pixels.size(),
                                                   " bytes, want 1 to ", kMaxSide, " a side and 3 bytes a pixel"));
  }
  png_image image = {};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(width);
  image.height = static_cast<png_uint_32>(height);
  image.format = PNG_FORMAT_RGB;
  image.flags = PNG_IMAGE_FLAG_FAST;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(image);
  std::string file(size, '\0');
  if (png_image_write_to_memory(&image, file.data(), &size, /*convert_to_8_bit=*/0, pixels.data(), /*row_stride=*/0,
                                /*colormap=*/nullptr) == 0) {
    return absl::InternalError(absl::StrCat("libpng could not encode the picture: ", image.message));
  }
  file.resize(size);
  return file;
}

}  // namespace craftfleet
