// How far the night's noise covers each pixel of the map: 0 in the middle, towards 1 at the corners. The values reach
// pixels, so they use our own exponential function: the last bit of libm's depends on the CPU.
//
// cover(x, y) = 1 - exp(-(0.5 * (X*X + Y*Y) / 0.25)) with X = x * (2 / (map width - 1)) - 1, the last one exactly 1,
// and Y in the same way.

#pragma once

#include <vector>

namespace craftfleet {

// exp(-x), correctly rounded but for about one x in 2^40, for x in 0..4. The same bits on every machine.
double ExpOfMinus(double x);

// double[width][height], y fastest: the cover of a map of that many pixels, 2 or more each way.
std::vector<double> Vignette(int width, int height);

}  // namespace craftfleet
