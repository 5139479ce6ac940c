// The parts of a learner that its services use, for tests and fuzz targets.

#ifndef CRAFTFLEET_TESTS_LEARNER_LEARNER_PARTS_H_
#define CRAFTFLEET_TESTS_LEARNER_LEARNER_PARTS_H_

#include "common/base/clock.h"
#include "learner/learner_service.h"
#include "tests/fakes/wire_samples.h"
#include "tests/learner/test_registry.h"

namespace craftfleet {

// The parts of a new run with kSampleShape.
struct LearnerParts {
  explicit LearnerParts(Clock* clock) : registry(Options(), clock) {}

  static WorkerRegistry::Options Options() {
    WorkerRegistry::Options options;
    options.lanes.lanes = kSampleShape.lanes;
    return options;
  }

  TestRegistry registry;
  WeightStore weights;
  FragmentQueue fragments{100};
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_LEARNER_LEARNER_PARTS_H_
