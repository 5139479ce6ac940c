// A network's parameters as LibTorch sees them.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_PARAM_TENSORS_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_PARAM_TENSORS_H_

#include <map>
#include <memory>
#include <vector>

#include <ATen/core/Tensor.h>

#include "common/agent/nets/fft_conv.h"
#include "common/agent/nets/params.h"

namespace craftfleet {

// What layers compute from their weights alone, by the weight: once for all rows, shards and passes between two changes
// of the weights (Network::Prepare).
struct PreparedWeights {
  std::map<ParamIndex, FftFilters> filters;
};

struct ParamTensors {
  std::vector<at::Tensor> tensors;                            // in ParamList's order
  at::ScalarType multiplied_as = at::kFloat;                  // by convolutions and linear layers: float or bfloat16
  std::shared_ptr<const PreparedWeights> prepared = nullptr;  // of these weights; null: layers prepare what they need

  const at::Tensor& operator[](ParamIndex index) const { return tensors[index]; }
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_PARAM_TENSORS_H_
