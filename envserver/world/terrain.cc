#include "envserver/world/terrain.h"

#include <cmath>

namespace craftfleet {
namespace {
double At(const SimplexNoise& noise, double x, double y, double z) {
  double out;
  noise.Evaluate(absl::MakeConstSpan(&x, 1), absl::MakeConstSpan(&y, 1), z, absl::MakeSpan(&out, 1));
  return out;
}

}  // namespace

std::vector<uint16_t> ComputeTraits(const SimplexNoise& noise, int width, int height, Position player) {
  std::vector<uint16_t> traits(width * height);
  for (int x = 0; x < width; ++x) {
    for (int y = 0; y < height; ++y) {
      const double dx = x - player.x, dy = y - player.y;
      double start = 4 - std::sqrt(dx * dx + dy * dy);
      start += 2 * At(noise, x / 3., y / 3., 8);
      start = 1 / (1 + std::exp(-start));
      double water = At(noise, x / 15., y / 15., 3) + 0.15 * At(noise, x / 5., y / 5., 3);
      water += 0.1;
      water -= 2 * start;
      double mountain = (At(noise, x / 15., y / 15., 0) + 0.3 * At(noise, x / 5., y / 5., 0)) / 1.3;
      mountain -= 4 * start + 0.3 * water;
      uint16_t& t = traits[x * height + y];
      const auto set = [&](Trait trait, bool on) {
        if (on) t |= trait;
      };
      set(kStart, start > 0.5);
      set(kMountain, mountain > 0.15);
      set(kHigh, mountain > 0.18);
      set(kPeak, mountain > 0.3);
      set(kCave, At(noise, x / 7., y / 7., 6) > 0.15);
      set(kTunnel, At(noise, 2 * x / 3., y / 5. / 3., 7) > 0.4 || At(noise, x / 5. / 3., 2 * y / 3., 7) > 0.4);
      set(kCoalVein, At(noise, x / 8., y / 8., 1) > 0);
      set(kIronVein, At(noise, x / 6., y / 6., 2) > 0.4);
      set(kLavaField, At(noise, x / 5., y / 5., 6) > 0.35);
      set(kShore, 0.25 < water && water <= 0.35);
      set(kSea, 0.3 < water);
      set(kSandy, At(noise, x / 9., y / 9., 4) > -0.2);
      set(kForest, At(noise, x / 7., y / 7., 5) > 0);
    }
  }
  return traits;
}

}  // namespace craftfleet
