#include "envserver/render/rough_night.h"

#include <algorithm>

#include "common/base/cpu_path.h"
#include "envserver/render/light.h"

namespace craftfleet {
namespace {

// A channel's values before their fractions are dropped are within these of the exact ones. They are computed so much
// too large; a whole part may be wrong where the fraction is then below twice that.
constexpr float kNoiseError = 1e-4F;            // with noise; at most 0.8e-4
constexpr float kLitError = kFarFromWhole / 2;  // lit; at most 0.4e-4

struct Light {
  float amount;  // of noise, in full cover
  float daylight;
  float half_dark;
};

// A value of 0 or more without its fraction.
struct Whole {
  explicit CRAFTFLEET_KERNEL_BODY Whole(float exact)
      : integer(static_cast<int32_t>(exact)), value(static_cast<float>(integer)), fraction(exact - value) {}

  int32_t integer;
  float value;  // the same
  float fraction;
};

CRAFTFLEET_KERNEL_BODY float Min(float a, float b) { return a < b ? a : b; }
CRAFTFLEET_KERNEL_BODY float LeastFraction(Whole a, Whole b, Whole c) {
  return Min(Min(a.fraction, b.fraction), c.fraction);
}

// As light.cc, but with floats, and fused operations where the CPU has them. With kLitIsSure, no pixel is unsure
// because of a lit value.
template <bool kLitIsSure>
CRAFTFLEET_KERNEL_BODY void LightLoop(const Light* light, const uint32_t* __restrict high,
                                      const float* __restrict cover, const Pixel* __restrict canvas, int blocks,
                                      Pixel* __restrict lit, uint32_t* __restrict unsure) {
  const Light l = *light;
  for (int block = 0; block < blocks; ++block) {
    const uint32_t bit = uint32_t{1} << block % kBlocksPerGroup;
    uint32_t* const words = unsure + block / kBlocksPerGroup * kNightBlock;
    for (int n = 0; n < kNightBlock; ++n) {
      const int i = block * kNightBlock + n;
      const auto red = static_cast<float>(static_cast<int32_t>(canvas[i] & 255));
      const auto green = static_cast<float>(static_cast<int32_t>(canvas[i] >> 8 & 255));
      const auto blue = static_cast<float>(static_cast<int32_t>(canvas[i] >> 16 & 255));
      const auto noise = static_cast<float>(static_cast<int32_t>(high[i] >> 8));
      const float covered = l.amount * cover[i];
      const float clear = 1 - covered;
      const float grain = covered * (32 + noise * (95.0F / (1 << 24))) + kNoiseError;
      const Whole night_red(clear * red + grain);
      const Whole night_green(clear * green + grain);
      const Whole night_blue(clear * blue + grain);
      const Whole luma(night_red.value * (19595.0F / 65536) +
                       (night_green.value * (38470.0F / 65536) + (night_blue.value * (7471.0F / 65536) + 0.5F)));
      // Dim() is the whole part of 3/5 luma + 2/5 channel, whose fraction is a multiple of 1/5: 0.1 keeps it away from
      // whole numbers.
      const float dim = 0.6F * luma.value + 0.1F;
      const Whole dim_red(0.4F * night_red.value + dim);
      const Whole dim_green(0.4F * night_green.value + dim);
      const Whole dim_blue(0.4F * night_blue.value + dim);
      const Whole lit_red(l.half_dark * dim_red.value + (l.daylight * red + kLitError));
      const Whole lit_green(l.half_dark * dim_green.value + (l.daylight * green + (16 * l.half_dark + kLitError)));
      const Whole lit_blue(l.half_dark * dim_blue.value + (l.daylight * blue + (64 * l.half_dark + kLitError)));
      lit[i] = lit_red.integer | lit_green.integer << 8 | lit_blue.integer << 16;

      bool is_unsure = LeastFraction(night_red, night_green, night_blue) < 2 * kNoiseError;
      if (!kLitIsSure) is_unsure = is_unsure | (LeastFraction(lit_red, lit_green, lit_blue) < 2 * kLitError);
      words[n] |= bit & -static_cast<uint32_t>(is_unsure);
    }
  }
}
CRAFTFLEET_KERNEL(SureLight, LightLoop<true>)
CRAFTFLEET_KERNEL(UnsureLight, LightLoop<false>)

}  // namespace

void LightRoughly(double daylight, bool lit_is_sure, const uint32_t* high, const float* cover, const Pixel* canvas,
                  int blocks, Pixel* lit, uint32_t* unsure) {
  const Light light = {static_cast<float>(2 * (kNoiseBelow - daylight)), static_cast<float>(daylight),
                       static_cast<float>(0.5 * (1 - daylight))};
  std::fill_n(unsure, UnsureWords(blocks), 0);
  if (lit_is_sure) {
    SureLight(&light, high, cover, canvas, blocks, lit, unsure);
  } else {
    UnsureLight(&light, high, cover, canvas, blocks, lit, unsure);
  }
}

}  // namespace craftfleet
