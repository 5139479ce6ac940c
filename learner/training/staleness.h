// How old the weights were that played the fragments of an update.

#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "common/base/types.h"

namespace craftfleet {

// In versions, from those that played a fragment to those from which the update started.
struct Staleness {
  int64_t min = 0;
  double mean = 0;
  int64_t max = 0;
};

// That of `fragments`, one or more, in an update from `version`.
inline Staleness StalenessOf(const std::vector<Fragment>& fragments, int64_t version) {
  Staleness staleness;
  staleness.min = staleness.max = version - fragments.front().policy_version;
  for (const Fragment& fragment : fragments) {
    const int64_t lag = version - fragment.policy_version;
    staleness.min = std::min(staleness.min, lag);
    staleness.max = std::max(staleness.max, lag);
    staleness.mean += static_cast<double>(lag) / static_cast<double>(fragments.size());
  }
  return staleness;
}

}  // namespace craftfleet
