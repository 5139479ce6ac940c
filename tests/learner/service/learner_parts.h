// The parts of a learner that its services use, for tests and fuzz targets.

#pragma once

#include <cstdint>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "learner/service/learner_service.h"
#include "tests/fakes/wire_samples.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {

// Options of a service for a run with kSampleShape.
inline LearnerServiceImpl::Options SampleServiceOptions(int64_t epoch, absl::Duration lease) {
  LearnerServiceImpl::Options options;
  options.run_id = "run-a";
  options.epoch = epoch;
  options.config.set_lanes(kSampleShape.lanes);
  options.shape = kSampleShape;
  options.lease = lease;
  return options;
}

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
