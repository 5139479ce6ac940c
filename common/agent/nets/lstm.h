// An LSTM with autograd over segments of different lengths.

#pragma once

#include <cstdint>
#include <vector>

#include <ATen/core/Tensor.h>

namespace craftfleet {

struct LstmWeights {
  at::Tensor input;        // float[4H,in], gates in the order i, f, g, o
  at::Tensor hidden;       // float[4H,H]
  at::Tensor input_bias;   // float[4H]
  at::Tensor hidden_bias;  // float[4H]
};

struct LstmOutput {
  at::Tensor outputs;      // float[N,H]
  at::Tensor last_states;  // float[k,2H] after each segment; no gradient flows from it
};

// `input` float[N,in] holds k segments as LibTorch's packed sequences do: the first step of each, the longest first,
// then all second steps and so on; batch_sizes[t] segments have a step t. `states` float[k,2H], h then c, are
// constants.
//
// Not at::lstm: on the CPU it multiplies by the BLAS and sums the weights' gradients step by step, so that updates take
// 6 times as long; on a GPU it warns at each call, and asks cuDNN for the place of each weight again.
LstmOutput Lstm(const at::Tensor& input, const std::vector<int64_t>& batch_sizes, const at::Tensor& states,
                const LstmWeights& weights);

}  // namespace craftfleet
