// Whether a configuration can run, looked at before anything is made of it.

#ifndef CRAFTFLEET_LEARNER_RUNNABLE_CONFIG_H_
#define CRAFTFLEET_LEARNER_RUNNABLE_CONFIG_H_

#include <cstdint>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/agent/agent_spec.h"
#include "common/wire/convert.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Fills in what follows from the rest and checks all of it.
//   InvalidArgument: a value that is out of range or does not fit another; names the field.
absl::StatusOr<v1::RunConfig> CompleteConfig(v1::RunConfig config);

// What a fragment of the run looks like. `config` is complete, here and below.
wire::FragmentShape FragmentShapeOf(const v1::RunConfig& config, const AgentSpec& spec);

// The most that a fragment can have on the wire, bytes.
int64_t LargestFragmentBytes(const wire::FragmentShape& shape);

// The most that any message to a learner of such fragments can have, bytes; at most wire::kMaxMessageBytes.
int LargestMessageBytes(const wire::FragmentShape& shape);

// What a learner has.
struct LearnerMachine {
  int64_t memory_bytes = 0;    // 0: not known, anything goes
  bool updates_on_cpu = true;  // else gradients and minibatches lie elsewhere
};

// Of this machine and the cgroup at the top of what this process sees; 0: not known.
int64_t OwnMemoryBytes();

// Whether the run fits through the wire and into the learner's memory, of which no more is counted than is needed in
// any case.
//   InvalidArgument: it does not; names the field that takes most.
absl::Status CheckRunnable(const v1::RunConfig& config, const AgentSpec& spec, const LearnerMachine& machine);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUNNABLE_CONFIG_H_
