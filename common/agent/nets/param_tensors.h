// A network's parameters as LibTorch sees them.

#pragma once

#include <map>
#include <memory>
#include <vector>

#include <ATen/core/Tensor.h>

#include "common/agent/nets/params.h"
#include "common/agent/nets/prepared_weights.h"
#include "common/agent/nets/wide_linear.h"

namespace craftfleet {

struct ParamTensors {
  std::vector<at::Tensor> tensors;                            // in ParamList's order
  at::ScalarType multiplied_as = at::kFloat;                  // by convolutions and linear layers: float or bfloat16
  std::shared_ptr<const PreparedWeights> prepared = nullptr;  // of these weights; null: layers prepare what they need
  // Weights whose gradients backward passes leave as factors.
  std::map<ParamIndex, c10::intrusive_ptr<WideFactors>> wide_factors;
  // All of them as `multiplied_as`; empty: each pass converts what it needs.
  std::vector<at::Tensor> converted = {};

  const at::Tensor& operator[](ParamIndex index) const { return tensors[index]; }

  // As convolutions and linear layers take it.
  at::Tensor Multiplied(ParamIndex index) const {
    return converted.empty() ? tensors[index].to(multiplied_as) : converted[index];
  }

  // Null: it has not been prepared.
  const PreparedWeight* FindPrepared(ParamIndex weight) const {
    if (prepared == nullptr) return nullptr;
    const auto found = prepared->by_weight.find(weight);
    return found == prepared->by_weight.end() ? nullptr : &found->second;
  }

  // Null: the weight gets its gradient.
  c10::intrusive_ptr<WideFactors> FindWideFactors(ParamIndex weight) const {
    const auto found = wide_factors.find(weight);
    return found == wide_factors.end() ? c10::intrusive_ptr<WideFactors>() : found->second;
  }
};

}  // namespace craftfleet
