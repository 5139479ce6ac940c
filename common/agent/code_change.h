// How the features of a frame change at an achievement.

#pragma once

#include <absl/types/span.h>

namespace craftfleet {

// Writes (after - before), scaled to length 1; a change of length 0 stays 0. All three are float[F].
// Source: AGENTS.md, section 12.
void CodeChange(absl::Span<const float> before, absl::Span<const float> after, absl::Span<float> change);

}  // namespace craftfleet
