// The initial weights of a run.

#pragma once

#include <cstdint>
#include <vector>

#include "common/agent/agent_spec.h"
#include "common/base/worker_pool.h"

namespace craftfleet {

// float[spec.param_count]: each parameter as its `init` says; orthogonal matrices have orthonormal rows if they are
// wide, columns if they are tall. Depends on `seed` and the parameters' names alone. `workers`, if any, share the work.
//
//   linear layers and convolutions of extractors and object modules: orthogonal, gain sqrt(2); a convolution as
//     [outputs, inputs * k * k]. action_net: gain 0.01, so that the first policy is nearly uniform. value_net: gain 1,
//     0.1 in residual networks. Their biases: zero.
//   all tensors of an LSTM: uniform in +-1/16. `critic`: uniform in +-1/sqrt(features).
//   CLS token, slots: normal, variance 1. Weight and bias of norms: 1 and 0.
//   residual networks but for their heads: uniform numbers, each output's row scaled to an L2 norm: 1 for `embed`, the
//     first convolution of a stack and `linear1`, 1.4 for `linear0`, sqrt(1 / (sqrt(stacks) * sqrt(2))) for the
//     convolutions of blocks, with 3 stacks in RESNET and 1 in GRID_RESNET; 1.4 and 1 for the two layers of film and of
//     predictor, whose biases start at 0.
std::vector<float> InitialWeights(const AgentSpec& spec, uint64_t seed, WorkerPool* workers = nullptr);

}  // namespace craftfleet
