#include "common/agent/weights.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// Room in the header of safetensors for what is not a name.
constexpr int64_t kMetadataBytes = 1024;
constexpr int64_t kEntryBytes = 256;  // of one tensor: type, shape of at most four sizes, offsets

std::string FormatShape(const std::vector<int64_t>& shape) { return absl::StrCat("[", absl::StrJoin(shape, ","), "]"); }

}  // namespace

std::vector<SafeTensor> AsTensors(const AgentSpec& spec, absl::string_view prefix, absl::Span<const float> values) {
  std::vector<SafeTensor> tensors;
  for (const ParamSpec& param : spec.params) {
    const char* data = reinterpret_cast<const char*>(values.data() + param.offset);
    tensors.push_back({absl::StrCat(prefix, param.name), param.shape, {data, param.size * sizeof(float)}});
  }
  return tensors;
}

absl::Status CopyTensors(const AgentSpec& spec, absl::string_view prefix, absl::Span<const SafeTensor> tensors,
                         absl::Span<float> values) {
  std::map<std::string, const SafeTensor*> by_name;
  for (const SafeTensor& tensor : tensors) {
    if (absl::StartsWith(tensor.name, prefix)) by_name.emplace(tensor.name.substr(prefix.size()), &tensor);
  }
  std::vector<absl::string_view> sources;
  for (const ParamSpec& param : spec.params) {
    const auto found = by_name.find(param.name);
    if (found == by_name.end()) {
      return absl::InvalidArgumentError(absl::StrCat(spec.name, ": tensor \"", prefix, param.name, "\" is missing"));
    }
    if (found->second->type != SafeTensor::Type::kFloat32) {
      return absl::InvalidArgumentError(absl::StrCat(spec.name, ": tensor \"", prefix, param.name, "\" is not F32"));
    }
    if (found->second->shape != param.shape) {
      return absl::InvalidArgumentError(absl::StrCat(spec.name, ": tensor \"", prefix, param.name, "\" has shape ",
                                                     FormatShape(found->second->shape), ", want ",
                                                     FormatShape(param.shape)));
    }
    sources.push_back(found->second->data);
    by_name.erase(found);
  }
  if (!by_name.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(spec.name, " has no tensor \"", prefix, by_name.begin()->first, "\""));
  }
  for (size_t i = 0; i < sources.size(); ++i) {
    std::memcpy(values.data() + spec.params[i].offset, sources[i].data(), sources[i].size());
  }
  return absl::OkStatus();
}

std::string SaveWeights(const AgentSpec& spec, absl::Span<const float> weights) {
  return WriteSafetensors({AsTensors(spec, "", weights), {{"agent", spec.name}, {"format", "pt"}}});
}

int64_t MaxWeightsBytes(const AgentSpec& spec) {
  int64_t bytes = kMetadataBytes + static_cast<int64_t>(spec.name.size());
  for (const ParamSpec& param : spec.params) bytes += kEntryBytes + static_cast<int64_t>(param.name.size());
  return bytes + spec.param_count * static_cast<int64_t>(sizeof(float));
}

namespace {

absl::Status CheckFinite(const AgentSpec& spec, absl::Span<const float> weights) {
  const auto* const bad =
      std::find_if_not(weights.begin(), weights.end(), [](float weight) { return std::isfinite(weight); });
  if (bad == weights.end()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(spec.name, ": weight ", bad - weights.begin(), " is ", *bad, ", want finite numbers"));
}

// Where the weights lie in `file`, if they do so one after the other and aligned; null otherwise.
const float* FindInOrder(const AgentSpec& spec, const SafeTensors& file) {
  if (file.tensors.size() != spec.params.size()) return nullptr;
  const char* const begin = file.tensors.front().data.data();
  for (size_t i = 0; i < spec.params.size(); ++i) {
    const SafeTensor& tensor = file.tensors[i];
    const ParamSpec& param = spec.params[i];
    const bool is_in_place = tensor.data.data() == begin + param.offset * sizeof(float);
    if (tensor.name != param.name || tensor.shape != param.shape || tensor.type != SafeTensor::Type::kFloat32 ||
        !is_in_place) {
      return nullptr;
    }
  }
  const bool is_aligned = reinterpret_cast<uintptr_t>(begin) % alignof(float) == 0;
  return is_aligned ? reinterpret_cast<const float*>(begin) : nullptr;
}

}  // namespace

absl::StatusOr<std::vector<float>> LoadWeights(const AgentSpec& spec, absl::string_view bytes) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const SafeTensors file, ReadSafetensors(bytes));
  std::vector<float> weights(spec.param_count);
  CRAFTFLEET_RETURN_IF_ERROR(CopyTensors(spec, "", file.tensors, absl::MakeSpan(weights)));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFinite(spec, weights));
  return weights;
}

absl::StatusOr<std::shared_ptr<const float>> ShareWeights(const AgentSpec& spec,
                                                          std::shared_ptr<const std::string> bytes) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const SafeTensors file, ReadSafetensors(*bytes));
  const float* const weights = FindInOrder(spec, file);
  if (weights == nullptr) {
    CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<float> copy, LoadWeights(spec, *bytes));
    const auto owner = std::make_shared<const std::vector<float>>(std::move(copy));
    return std::shared_ptr<const float>(owner, owner->data());
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckFinite(spec, {weights, static_cast<size_t>(spec.param_count)}));
  return std::shared_ptr<const float>(std::move(bytes), weights);
}

}  // namespace craftfleet
