#include "envserver/render/light.h"

#include <cstdint>

#include <absl/container/fixed_array.h>

#include "common/base/cpu_path.h"
#include "envserver/world/random_stream.h"

namespace craftfleet {
namespace {

// The night's tint, doubled: in full darkness a channel is half of its dimmed value plus this.
constexpr int32_t kTwiceTintGreen = 16;
constexpr int32_t kTwiceTintBlue = 64;

struct Rgb {
  int32_t red;
  int32_t green;
  int32_t blue;
};

Rgb Unpack(Pixel pixel) {
  return {static_cast<int32_t>(pixel & 255), static_cast<int32_t>(pixel >> 8 & 255),
          static_cast<int32_t>(pixel >> 16 & 255)};
}

Pixel Pack(int32_t red, int32_t green, int32_t blue) { return red | green << 8 | blue << 16; }

// Floats hold every step exactly: the sum stays below 2^24.
int32_t Luma(Rgb c) {
  const float sum = 19595.0f * static_cast<float>(c.red) + 38470.0f * static_cast<float>(c.green) +
                    7471.0f * static_cast<float>(c.blue) + 32768.0f;
  return static_cast<int32_t>(sum * (1.0f / 65536));
}

// Reduces the colour saturation to 0.4.
int32_t Dim(int32_t channel, float luma) {
  return static_cast<int32_t>(luma + 0.4f * (static_cast<float>(channel) - luma));
}

// daylight * day + (1 - daylight) * night / 2; halving is exact, so it may be done to the factor.
int32_t Mix(double daylight, int32_t day, double half_dark, int32_t twice_night) {
  return static_cast<int32_t>(daylight * day + half_dark * twice_night);
}

// `night` is the canvas with its noise.
Pixel Lit(double daylight, double half_dark, Rgb canvas, Rgb night) {
  const auto luma = static_cast<float>(Luma(night));
  return Pack(Mix(daylight, canvas.red, half_dark, Dim(night.red, luma)),
              Mix(daylight, canvas.green, half_dark, Dim(night.green, luma) + kTwiceTintGreen),
              Mix(daylight, canvas.blue, half_dark, Dim(night.blue, luma) + kTwiceTintBlue));
}

CRAFTFLEET_KERNEL_BODY void DayLoopBody(double daylight, int count, Pixel* pixels) {
  const double half_dark = 0.5 * (1 - daylight);
  for (int i = 0; i < count; ++i) {
    const Rgb canvas = Unpack(pixels[i]);
    pixels[i] = Lit(daylight, half_dark, canvas, canvas);
  }
}
CRAFTFLEET_KERNEL(DayLoop, DayLoopBody)

CRAFTFLEET_KERNEL_BODY void NightLoopBody(double daylight, const uint32_t* __restrict high,
                                          const uint32_t* __restrict low, const double* __restrict cover, int count,
                                          Pixel* __restrict pixels) {
  const double half_dark = 0.5 * (1 - daylight);
  const double amount = 2 * (kNoiseBelow - daylight);
  for (int i = 0; i < count; ++i) {
    const Rgb canvas = Unpack(pixels[i]);
    const double covered = amount * cover[i];
    const double clear = 1 - covered;
    const double grain = covered * (32 + 95 * RandomStream::UniformOf(high[i], low[i]));
    const Rgb night = {static_cast<int32_t>(clear * canvas.red + grain),
                       static_cast<int32_t>(clear * canvas.green + grain),
                       static_cast<int32_t>(clear * canvas.blue + grain)};
    pixels[i] = Lit(daylight, half_dark, canvas, night);
  }
}
CRAFTFLEET_KERNEL(NightLoop, NightLoopBody)

// Whether each lit value at this daylight is far from whole numbers, or whole and stays so in doubles. It is the canvas
// plus half_dark * (dimmed value + tint, doubled - twice the canvas): its fraction depends on that difference alone,
// which is within -510..319.
CRAFTFLEET_KERNEL_BODY void CheckLitBody(double daylight, bool* is_sure) {
  constexpr uint32_t kDifferences = 511;
  constexpr double kOne = 4294967296.0;  // of fractions in 32 bits
  constexpr auto kFar = static_cast<uint32_t>(kFarFromWhole * kOne);
  const double half_dark = 0.5 * (1 - daylight);
  const auto part = static_cast<uint32_t>(half_dark * kOne);
  uint32_t count = 0;
  for (uint32_t i = 1; i < kDifferences; ++i) count += static_cast<uint32_t>(i * part + kFar < 2 * kFar);
  for (int32_t canvas = 0; canvas < 256; ++canvas) {
    count += static_cast<uint32_t>(Mix(daylight, canvas, half_dark, 2 * canvas) != canvas);
  }
  *is_sure = count == 0;
}
CRAFTFLEET_KERNEL(CheckLit, CheckLitBody)

// Lights single pixels exactly, many at a time.
class ExactPixels {
 public:
  ExactPixels(double daylight, const NightPixels& map) : daylight_(daylight), map_(map) {}

  void Add(int i) {
    places_[count_] = i;
    high_[count_] = map_.high[i];
    low_[count_] = map_.low[i];
    cover_[count_] = map_.cover[i];
    pixels_[count_] = map_.canvas[i];
    if (++count_ == kMost) Light();
  }
  // To be called after the last Add().
  void Light() {
    NightLoop(daylight_, high_, low_, cover_, count_, pixels_);
    for (int n = 0; n < count_; ++n) map_.lit[places_[n]] = pixels_[n];
    count_ = 0;
  }

 private:
  static constexpr int kMost = 128;

  const double daylight_;
  const NightPixels& map_;
  int count_ = 0;
  int places_[kMost];
  uint32_t high_[kMost];
  uint32_t low_[kMost];
  double cover_[kMost];
  Pixel pixels_[kMost];
};

CRAFTFLEET_KERNEL_BODY void SleepLoopBody(int count, Pixel* pixels) {
  for (int i = 0; i < count; ++i) {
    const int32_t half = Luma(Unpack(pixels[i])) >> 1;
    pixels[i] = Pack(half, half, half + 8);
  }
}
CRAFTFLEET_KERNEL(SleepLoop, SleepLoopBody)

}  // namespace

void LightByDay(double daylight, absl::Span<Pixel> pixels) {
  DayLoop(daylight, static_cast<int>(pixels.size()), pixels.data());
}

void LightByNight(double daylight, const NightPixels& map) {
  const int blocks = static_cast<int>(map.canvas.size()) / kNightBlock;
  absl::FixedArray<uint32_t, 128> unsure(UnsureWords(blocks));
  bool lit_is_sure = false;
  CheckLit(daylight, &lit_is_sure);
  LightRoughly(daylight, lit_is_sure, map.high.data(), map.float_cover.data(), map.canvas.data(), blocks,
               map.lit.data(), unsure.data());
  ExactPixels exact(daylight, map);
  for (size_t word = 0; word < unsure.size(); ++word) {
    for (uint32_t rest = unsure[word]; rest != 0; rest &= rest - 1) {
      exact.Add(PixelOfBit(static_cast<int>(word), __builtin_ctz(rest)));
    }
  }
  exact.Light();
}

void LightAsleep(absl::Span<Pixel> pixels) { SleepLoop(static_cast<int>(pixels.size()), pixels.data()); }

}  // namespace craftfleet
