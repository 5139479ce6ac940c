// A network's parameters as LibTorch sees them.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_PARAM_TENSORS_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_PARAM_TENSORS_H_

#include <vector>

#include <ATen/core/Tensor.h>

#include "common/agent/nets/params.h"

namespace craftfleet {

struct ParamTensors {
  std::vector<at::Tensor> tensors;            // in ParamList's order
  at::ScalarType multiplied_as = at::kFloat;  // by convolutions and linear layers: float or bfloat16

  const at::Tensor& operator[](ParamIndex index) const { return tensors[index]; }
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_PARAM_TENSORS_H_
