// In which order an epoch visits the steps of a rollout.

#ifndef CRAFTFLEET_LEARNER_PPO_MINIBATCHES_H_
#define CRAFTFLEET_LEARNER_PPO_MINIBATCHES_H_

#include <cstdint>
#include <vector>

namespace craftfleet {

// A permutation of 0..count-1, each equally likely, that follows from the run's seed, the iteration and the epoch.
// Consecutive pieces are the epoch's minibatches.
std::vector<int> MinibatchOrder(uint64_t run_seed, int64_t iteration, int epoch, int count);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_MINIBATCHES_H_
