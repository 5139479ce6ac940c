// What layers compute from their weights alone. Includes LibTorch's tensors.

#pragma once

#include <functional>
#include <map>
#include <utility>
#include <vector>

#include <ATen/core/Tensor.h>

#include "common/agent/nets/params.h"

namespace craftfleet {

// A weight as a layer's kernels read it: spectra (fft_conv.h) or panels (direct_conv.h).
struct PreparedWeight {
  at::Tensor for_output;
  at::Tensor for_input_gradient;  // undefined: no backward pass needs it
};

// Once for all rows, shards and passes between two changes of the weights (Network::Prepare).
struct PreparedWeights {
  std::map<ParamIndex, PreparedWeight> by_weight;
};

// Prepared weights in the making: layers add room for their own, and a task that fills it. Tasks are independent of
// each other.
struct Preparation {
  bool for_gradients = false;  // also what a backward pass needs
  PreparedWeights weights;
  std::vector<std::function<void()>> tasks;

  void Add(ParamIndex weight, PreparedWeight prepared, std::function<void()> fill) {
    weights.by_weight[weight] = std::move(prepared);
    tasks.push_back(std::move(fill));
  }
};

}  // namespace craftfleet
