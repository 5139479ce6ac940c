#include "learner/ppo/minibatches.h"

#include <numeric>
#include <utility>

#include "common/keyed_random.h"

namespace craftfleet {

std::vector<int> MinibatchOrder(uint64_t run_seed, int64_t iteration, int epoch, int count) {
  const uint64_t seed =
      KeyedBits(RandomUse::kMinibatchOrder, run_seed, static_cast<uint64_t>(iteration), static_cast<uint64_t>(epoch));
  std::vector<int> order(count);
  std::iota(order.begin(), order.end(), 0);
  // Fisher and Yates. 53 random bits leave a bias below 2^-30 for any count that fits memory.
  for (int last = count - 1; last > 0; --last) {
    const double uniform = UnitInterval(KeyedBits(RandomUse::kMinibatchOrder, seed, static_cast<uint64_t>(last), 0));
    std::swap(order[last], order[static_cast<int>(uniform * (last + 1))]);
  }
  return order;
}

}  // namespace craftfleet
