// Compares what two updaters have saved.

#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include <ATen/ATen.h>
#include <absl/strings/match.h>
#include <absl/strings/string_view.h>

#include "common/agent/safetensors.h"

namespace craftfleet {

// All float tensors of a safetensors file whose names start with `prefix`, one after the other as float[n].
inline at::Tensor SavedTensors(const std::string& bytes, absl::string_view prefix = "") {
  std::vector<at::Tensor> found;
  const SafeTensors file = *ReadSafetensors(bytes);
  for (const SafeTensor& tensor : file.tensors) {
    if (!absl::StartsWith(tensor.name, prefix) || tensor.type != SafeTensor::Type::kFloat32) continue;
    found.push_back(at::empty({static_cast<int64_t>(tensor.data.size() / sizeof(float))}));
    std::memcpy(found.back().data_ptr<float>(), tensor.data.data(), tensor.data.size());
  }
  return at::cat(found);
}

// The distance of `actual` from `expected` as a share of that from `start` to `expected`.
inline double ShareOfWay(const at::Tensor& actual, const at::Tensor& expected, const at::Tensor& start) {
  const auto length = [](const at::Tensor& x) { return std::sqrt(x.square().sum(at::kDouble).item<double>()); };
  return length(actual - expected) / length(expected - start);
}

}  // namespace craftfleet
