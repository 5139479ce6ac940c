#include "envserver/render/rough_night.h"

#include <array>
#include <cstring>

#include "common/base/cpu_path.h"
#include "envserver/render/light.h"

namespace craftfleet {
namespace {

// Adding it rounds a float of 0..255 to a whole number, which is then in the lowest bits.
constexpr float kRounder = 3 << 22;

// A channel's values before their fractions are dropped are within this of the exact ones: those with noise within
// 1.6e-4, the lit ones within 0.7e-4. Where one is nearer to a whole number, the pixel is unsure.
constexpr float kError = 2e-4F;

constexpr std::array<uint32_t, kNightBlock> MakeBits() {
  std::array<uint32_t, kNightBlock> bits{};
  for (int n = 0; n < kNightBlock; ++n) bits[n] = uint32_t{1} << n;
  return bits;
}
constexpr std::array<uint32_t, kNightBlock> kBits = MakeBits();

struct Light {
  float amount;  // of noise, in full cover
  float daylight;
  float half_dark;
};

// A value less 0.5, rounded: so its whole part, unless it is near a whole number.
struct Whole {
  explicit CRAFTFLEET_KERNEL_BODY Whole(float value_less_half)
      : rounder_plus(value_less_half + kRounder),
        value(rounder_plus - kRounder),
        squared_rest((value_less_half - value) * (value_less_half - value)) {}

  float rounder_plus;
  float value;
  float squared_rest;  // near a whole number nearly 0.25
};

float Max(float a, float b) { return a > b ? a : b; }

Pixel Byte(Whole whole) {
  Pixel bits;
  std::memcpy(&bits, &whole.rounder_plus, sizeof(bits));
  return bits & 255;
}

// As light.cc, but with floats, and fused operations where the CPU has them.
CRAFTFLEET_KERNEL_BODY void LightLoop(const Light* light, const uint32_t* __restrict high,
                                      const float* __restrict cover, const Pixel* __restrict canvas, int blocks,
                                      Pixel* __restrict lit, uint32_t* __restrict unsure) {
  const Light l = *light;
  constexpr float kLimit = (0.5F - kError) * (0.5F - kError);
  for (int block = 0; block < blocks; ++block) {
    uint32_t bits = 0;
    for (int n = 0; n < kNightBlock; ++n) {
      const int i = block * kNightBlock + n;
      const auto red = static_cast<float>(static_cast<int32_t>(canvas[i] & 255));
      const auto green = static_cast<float>(static_cast<int32_t>(canvas[i] >> 8 & 255));
      const auto blue = static_cast<float>(static_cast<int32_t>(canvas[i] >> 16 & 255));
      const auto noise = static_cast<float>(static_cast<int32_t>(high[i] >> 8));
      const float covered = l.amount * cover[i];
      const float clear = 1 - covered;
      const float grain = covered * (32 + noise * (95.0F / (1 << 24))) - 0.5F;
      const Whole night_red(clear * red + grain);
      const Whole night_green(clear * green + grain);
      const Whole night_blue(clear * blue + grain);
      const auto luma = static_cast<float>(
          static_cast<int32_t>(night_red.value * (19595.0F / 65536) + (night_green.value * (38470.0F / 65536) +
                                                                       (night_blue.value * (7471.0F / 65536) + 0.5F))));
      // Dim() is the whole part of 3/5 luma + 2/5 channel, whose fraction is a multiple of 1/5: 0.1 keeps it away from
      // whole numbers.
      const float dim = 0.6F * luma + (0.1F - 0.5F);
      const Whole dim_red(0.4F * night_red.value + dim);
      const Whole dim_green(0.4F * night_green.value + dim);
      const Whole dim_blue(0.4F * night_blue.value + dim);
      const Whole lit_red(l.half_dark * dim_red.value + (l.daylight * red - 0.5F));
      const Whole lit_green(l.half_dark * dim_green.value + (l.daylight * green + (16 * l.half_dark - 0.5F)));
      const Whole lit_blue(l.half_dark * dim_blue.value + (l.daylight * blue + (64 * l.half_dark - 0.5F)));
      lit[i] = Byte(lit_red) | Byte(lit_green) << 8 | Byte(lit_blue) << 16;
      float rest = Max(night_red.squared_rest, night_green.squared_rest);
      rest = Max(rest, night_blue.squared_rest);
      rest = Max(rest, lit_red.squared_rest);
      rest = Max(rest, lit_green.squared_rest);
      rest = Max(rest, lit_blue.squared_rest);

      bits |= kBits[n] & -static_cast<uint32_t>(rest > kLimit);
    }
    unsure[block] = bits;
  }
}
CRAFTFLEET_KERNEL(LightKernel, LightLoop)

}  // namespace

void LightRoughly(double daylight, const uint32_t* high, const float* cover, const Pixel* canvas, int blocks,
                  Pixel* lit, uint32_t* unsure) {
  const Light light = {static_cast<float>(2 * (kNoiseBelow - daylight)), static_cast<float>(daylight),
                       static_cast<float>(0.5 * (1 - daylight))};
  LightKernel(&light, high, cover, canvas, blocks, lit, unsure);
}

}  // namespace craftfleet
