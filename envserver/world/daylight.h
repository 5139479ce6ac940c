// Daylight by step. Source: RULES.md, section 9.

#pragma once

#include <cstdint>

namespace craftfleet {

// 0 (darkest) to 1 in the given step of an episode.
double Daylight(int64_t step);

}  // namespace craftfleet
