// What two actors that play the same fragment must agree on.

#ifndef CRAFTFLEET_COMMON_WIRE_FRAGMENT_DIGEST_H_
#define CRAFTFLEET_COMMON_WIRE_FRAGMENT_DIGEST_H_

#include <cstdint>

#include "common/types.h"

namespace craftfleet::wire {

// Of all that was played: everything but the epoch and what the learner adds. To be compared within a process, by which
// it is quick (some GB a second) and nothing that an enemy could not forge.
uint64_t FragmentDigest(const Fragment& fragment);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_FRAGMENT_DIGEST_H_
