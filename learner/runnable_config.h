// Checks that a configuration can run, before the learner allocates or writes anything.

#pragma once

#include <cstdint>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/agent/agent_spec.h"
#include "common/wire/convert.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Fills in fields that follow from others, and checks all fields.
//   InvalidArgument: a value is out of range or inconsistent with another; names the field.
absl::StatusOr<v1::RunConfig> CompleteConfig(v1::RunConfig config);

// The shape of the run's fragments. Here and below, `config` is complete (CompleteConfig).
wire::FragmentShape FragmentShapeOf(const v1::RunConfig& config, const AgentSpec& spec);

// The maximum size of a serialised fragment, in bytes.
int64_t LargestFragmentBytes(const wire::FragmentShape& shape);

// The maximum size of any message to the learner of such a run, in bytes; at most wire::kMaxMessageBytes.
int LargestMessageBytes(const wire::FragmentShape& shape);

// The resources of a learner.
struct LearnerMachine {
  int64_t memory_bytes = 0;    // 0: unknown, memory is not checked
  bool updates_on_cpu = true;  // false: gradients and minibatches are in another device's memory
};

// The smaller of the machine's memory and the tightest limit of this process' cgroups; 0: unknown.
int64_t OwnMemoryBytes();

// Checks that the run's messages fit the size limit, and that the learner's memory suffices. Counts only memory that is
// needed in any case.
//   InvalidArgument: they do not fit; names the field with the largest effect.
absl::Status CheckRunnable(const v1::RunConfig& config, const AgentSpec& spec, const LearnerMachine& machine);

}  // namespace craftfleet
