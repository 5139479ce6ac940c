#include "deploy/cli/screen/half_blocks.h"

#include <cstdint>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/check.h"

namespace craftfleet {
namespace {

constexpr char kUpperHalf[] = "\u2580";  // its colour is the upper pixel, the background the lower one

std::string ColorEscape(int code, absl::string_view pixel) {
  return absl::StrFormat("\x1b[%d;2;%d;%d;%dm", code, static_cast<uint8_t>(pixel[0]), static_cast<uint8_t>(pixel[1]),
                         static_cast<uint8_t>(pixel[2]));
}

}  // namespace

std::vector<std::string> HalfBlocks(absl::string_view picture, int width, int height) {
  CRAFTFLEET_CHECK(picture.size() == size_t{3} * width * height);
  constexpr absl::string_view kBlack("\0\0\0", 3);
  const auto pixel = [&](int x, int y) { return y < height ? picture.substr(size_t{3} * (y * width + x), 3) : kBlack; };
  std::vector<std::string> lines;
  for (int y = 0; y < height; y += 2) {
    std::string& line = lines.emplace_back();
    absl::string_view above;
    absl::string_view below;
    for (int x = 0; x < width; ++x) {
      if (pixel(x, y) != above) absl::StrAppend(&line, ColorEscape(38, pixel(x, y)));
      if (pixel(x, y + 1) != below) absl::StrAppend(&line, ColorEscape(48, pixel(x, y + 1)));
      above = pixel(x, y);
      below = pixel(x, y + 1);
      absl::StrAppend(&line, kUpperHalf);
    }
    absl::StrAppend(&line, "\x1b[0m");
  }
  return lines;
}

}  // namespace craftfleet
