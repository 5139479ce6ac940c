// What a learner's services steer, for fuzz targets.

#ifndef CRAFTFLEET_TESTS_FUZZ_LEARNER_BOOKS_H_
#define CRAFTFLEET_TESTS_FUZZ_LEARNER_BOOKS_H_

#include <vector>

#include "common/clock.h"
#include "learner/learner_service.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {

// Of a run with kSampleShape in which nothing has happened yet.
struct LearnerBooks {
  RealClock clock;
  LaneLedger ledger{{kSampleShape.lanes}, std::vector<LaneRecord>(kSampleShape.lanes), &clock};
  WeightStore weights;
  FragmentQueue fragments{100};
  EvaluationBook evaluations{absl::Seconds(5), &clock};
  ServerRegistry env_servers{absl::Seconds(5), &clock};
  FleetBook fleet{absl::Seconds(5), &clock};
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FUZZ_LEARNER_BOOKS_H_
