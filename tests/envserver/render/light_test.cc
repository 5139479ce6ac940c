// The light by night, whose floats must give what doubles give, on each CPU path.

#include "envserver/render/light.h"

#include <vector>

#include <gtest/gtest.h>

#include "envserver/world/random_stream.h"
#include "tests/fakes/cpu_paths.h"

namespace craftfleet {
namespace {

// RULES.md, section 13, word for word.
Pixel PlainLight(double daylight, double noise, double cover, Pixel canvas) {
  const double m = 2 * (0.5 - daylight) * cover;
  int with_noise[3];
  for (int k = 0; k < 3; ++k) {
    with_noise[k] = static_cast<int>((1 - m) * (canvas >> 8 * k & 255) + m * (32 + 95 * noise));
  }
  const int luma = (19595 * with_noise[0] + 38470 * with_noise[1] + 7471 * with_noise[2] + 32768) >> 16;
  const int tint[] = {0, 16, 64};
  Pixel lit = 0;
  for (int k = 0; k < 3; ++k) {
    const float part = 0.4f * static_cast<float>(with_noise[k] - luma);
    const int dim = static_cast<int>(static_cast<float>(luma) + part);
    const double value = daylight * (canvas >> 8 * k & 255) + 0.5 * (1 - daylight) * (dim + tint[k]);
    lit |= static_cast<Pixel>(value) << 8 * k;
  }
  return lit;
}

class LightByNightOnEachCpu : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(LightByNightOnEachCpu);

TEST_P(LightByNightOnEachCpu, EqualsThePlainFormulas) {
  constexpr int kPixels = 200 * kNightBlock;
  std::vector<uint32_t> high(kPixels);
  std::vector<uint32_t> low(kPixels);
  std::vector<double> cover(kPixels);
  std::vector<Pixel> canvas(kPixels);
  std::vector<Pixel> lit(kPixels);
  RandomStream random(5);
  for (int round = 0; round < 100; ++round) {
    // Full darkness and the last light before noise ends, too, where many values are near whole numbers.
    const double daylight = round == 0 ? 0 : round == 1 ? 0.4999999 : random.Uniform() / 2;
    random.FillWords(absl::MakeSpan(high), absl::MakeSpan(low));
    for (int i = 0; i < kPixels; ++i) {
      cover[i] = i % 50 == 0 ? 0 : random.Uniform();
      canvas[i] = random.Below(0xffffffff);
    }
    const std::vector<float> float_cover(cover.begin(), cover.end());
    LightByNight(daylight, {high, low, cover, float_cover, canvas, absl::MakeSpan(lit)});
    for (int i = 0; i < kPixels; ++i) {
      const double noise = RandomStream::UniformOf(high[i], low[i]);
      ASSERT_EQ(lit[i], PlainLight(daylight, noise, cover[i], canvas[i])) << round << ": " << i << ", " << daylight;
    }
  }
}

// Without cover a channel with noise is a whole number. So is the lit one, but for the rounding of doubles, where the
// dimmed channel and its tint are twice the canvas: in grey, green of 16 and blue of 64.
TEST_P(LightByNightOnEachCpu, IsExactWhereValuesAreWholeNumbers) {
  const std::vector<double> cover(256, 0);
  const std::vector<float> float_cover(256, 0);
  const std::vector<uint32_t> words(256, 0x12345678);
  std::vector<Pixel> canvas(256);
  std::vector<Pixel> lit(256);
  RandomStream random(6);
  for (int round = 0; round < 500; ++round) {
    const double daylight = random.Uniform() / 2;
    for (uint32_t i = 0; i < 256; ++i) canvas[i] = i | i << 8 | i << 16;
    LightByNight(daylight, {words, words, cover, float_cover, canvas, absl::MakeSpan(lit)});
    for (int i = 0; i < 256; ++i) ASSERT_EQ(lit[i], PlainLight(daylight, 0.5, 0, canvas[i])) << round << ": " << i;
  }
}

}  // namespace
}  // namespace craftfleet
