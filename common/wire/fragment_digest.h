// A digest that must be equal for two actors that play the same fragment.

#pragma once

#include <cstdint>

#include "common/base/types.h"

namespace craftfleet::wire {

// Covers everything but the epoch and the fields that the learner sets. Compare digests within one process only: the
// hash is fast (some GB a second), but not cryptographic. Thread-safe.
uint64_t FragmentDigest(const Fragment& fragment);

}  // namespace craftfleet::wire
