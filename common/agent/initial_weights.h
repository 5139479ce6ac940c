// The initial weights of a run.

#ifndef CRAFTFLEET_COMMON_AGENT_INITIAL_WEIGHTS_H_
#define CRAFTFLEET_COMMON_AGENT_INITIAL_WEIGHTS_H_

#include <cstdint>
#include <vector>

#include "common/agent/agent_spec.h"
#include "common/base/worker_pool.h"

namespace craftfleet {

// float[spec.param_count]: each parameter as its `init` says; orthogonal matrices have orthonormal rows if they are
// wide, columns if they are tall. Depends on `seed` and the parameters' names alone. `workers`, if any, share the work.
// Source: AGENTS.md, section 9.
std::vector<float> InitialWeights(const AgentSpec& spec, uint64_t seed, WorkerPool* workers = nullptr);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_INITIAL_WEIGHTS_H_
