// The weights that a run starts from.

#ifndef CRAFTFLEET_COMMON_AGENT_INITIAL_WEIGHTS_H_
#define CRAFTFLEET_COMMON_AGENT_INITIAL_WEIGHTS_H_

#include <cstdint>
#include <vector>

#include "common/agent/agent_spec.h"

namespace craftfleet {

// float[spec.param_count]: each weight a uniformly drawn orthogonal matrix (rows orthonormal if it is wide, columns if
// it is tall) times its gain, biases zero. A function of `seed` and the parameters' names alone.
// Source: "The agents", section 2.
std::vector<float> InitialWeights(const AgentSpec& spec, uint64_t seed);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_INITIAL_WEIGHTS_H_
