// The outputs of a value head that fragments may have.

#ifndef CRAFTFLEET_LEARNER_PPO_VALUE_RANGE_H_
#define CRAFTFLEET_LEARNER_PPO_VALUE_RANGE_H_

namespace craftfleet {

// By default those whose squares and sums stay finite (wire::kMaxValue).
struct ValueRange {
  double low = -1e6;
  double high = 1e6;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_VALUE_RANGE_H_
