#include "deploy/cli/screen/half_blocks.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/check.h"

namespace craftfleet {
namespace {

constexpr char kUpperHalf[] = "\u2580";  // its colour is the upper pixel, the background the lower one

using Pixel = std::array<int, 3>;

Pixel PixelOf(absl::string_view bytes) {
  return {static_cast<uint8_t>(bytes[0]), static_cast<uint8_t>(bytes[1]), static_cast<uint8_t>(bytes[2])};
}

int Distance(const Pixel& a, const Pixel& b) {
  int sum = 0;
  for (int i = 0; i < 3; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

// The nearest of xterm's 256: of its cube of 6x6x6 colours or of its 24 greys.
int NearestOf256(const Pixel& pixel) {
  constexpr std::array<int, 6> kLevels = {0, 95, 135, 175, 215, 255};
  int cube = 16;
  Pixel of_cube = {};
  for (int i = 0; i < 3; ++i) {
    const auto level = std::min_element(kLevels.begin(), kLevels.end(),
                                        [&](int a, int b) { return std::abs(a - pixel[i]) < std::abs(b - pixel[i]); });
    of_cube[i] = *level;
    cube += static_cast<int>(level - kLevels.begin()) * (i == 0 ? 36 : i == 1 ? 6 : 1);
  }
  const int step = std::clamp(((pixel[0] + pixel[1] + pixel[2]) / 3 - 3) / 10, 0, 23);
  const int grey = 8 + 10 * step;
  return Distance(pixel, {grey, grey, grey}) < Distance(pixel, of_cube) ? 232 + step : cube;
}

// The nearest of the 16, in xterm's shades; 8..15 are the bright ones.
int NearestOf16(const Pixel& pixel) {
  constexpr std::array<Pixel, 16> kShades = {{{0, 0, 0},
                                              {205, 0, 0},
                                              {0, 205, 0},
                                              {205, 205, 0},
                                              {0, 0, 238},
                                              {205, 0, 205},
                                              {0, 205, 205},
                                              {229, 229, 229},
                                              {127, 127, 127},
                                              {255, 0, 0},
                                              {0, 255, 0},
                                              {255, 255, 0},
                                              {92, 92, 255},
                                              {255, 0, 255},
                                              {0, 255, 255},
                                              {255, 255, 255}}};
  const auto nearest = std::min_element(kShades.begin(), kShades.end(), [&](const Pixel& a, const Pixel& b) {
    return Distance(a, pixel) < Distance(b, pixel);
  });
  return static_cast<int>(nearest - kShades.begin());
}

// `code`: 38 for the upper half, 48 for the lower one.
std::string ColorEscape(int code, absl::string_view bytes, Colors colors) {
  const Pixel pixel = PixelOf(bytes);
  if (colors == Colors::kTrue) return absl::StrFormat("\x1b[%d;2;%d;%d;%dm", code, pixel[0], pixel[1], pixel[2]);
  if (colors == Colors::k256) return absl::StrFormat("\x1b[%d;5;%dm", code, NearestOf256(pixel));
  const int shade = NearestOf16(pixel);
  return absl::StrFormat("\x1b[%dm", code - 8 + (shade < 8 ? shade : 60 + shade - 8));
}

}  // namespace

Colors ColorsOf(const char* colorterm, const char* term) {
  const absl::string_view named = colorterm != nullptr ? colorterm : "";
  const absl::string_view name = term != nullptr ? term : "";
  if (named == "truecolor" || named == "24bit" || absl::EndsWith(name, "-direct")) return Colors::kTrue;
  return absl::StrContains(name, "256color") ? Colors::k256 : Colors::k16;
}

std::vector<std::string> HalfBlocks(absl::string_view picture, int width, int height, Colors colors) {
  CRAFTFLEET_CHECK(picture.size() == size_t{3} * width * height);
  constexpr absl::string_view kBlack("\0\0\0", 3);
  const auto pixel = [&](int x, int y) { return y < height ? picture.substr(size_t{3} * (y * width + x), 3) : kBlack; };
  std::vector<std::string> lines;
  for (int y = 0; y < height; y += 2) {
    std::string& line = lines.emplace_back();
    absl::string_view above;
    absl::string_view below;
    for (int x = 0; x < width; ++x) {
      if (pixel(x, y) != above) absl::StrAppend(&line, ColorEscape(38, pixel(x, y), colors));
      if (pixel(x, y + 1) != below) absl::StrAppend(&line, ColorEscape(48, pixel(x, y + 1), colors));
      above = pixel(x, y);
      below = pixel(x, y + 1);
      absl::StrAppend(&line, kUpperHalf);
    }
    absl::StrAppend(&line, "\x1b[0m");
  }
  return lines;
}

}  // namespace craftfleet
