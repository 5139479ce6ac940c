#include "learner/scheduling/overdue.h"

#include <algorithm>
#include <vector>

namespace craftfleet {

void Overdue::Add(absl::Duration time) {
  times_.push_back(time);
  if (times_.size() > kKept) times_.pop_front();
  std::vector<absl::Duration> times(times_.begin(), times_.end());
  const auto middle = times.begin() + static_cast<std::ptrdiff_t>((times.size() - 1) / 2);
  std::nth_element(times.begin(), middle, times.end());
  limit_ = std::max(least_, kSeveral * *middle);
}

}  // namespace craftfleet
