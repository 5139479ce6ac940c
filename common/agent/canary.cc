#include "common/agent/canary.h"

#include <cmath>
#include <cstdint>
#include <exception>
#include <vector>

#include <ATen/ATen.h>
#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <google/protobuf/text_format.h>
#include <torch/version.h>

#include "common/agent/agent_spec.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/base/check.h"
#include "common/base/fnv1a.h"
#include "common/base/seeds.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// Small networks that together use the layers which canary.h lists, with convolutions by FFT with both sizes of tiles.
// Changing them changes every canary.
constexpr const char* kNetworks[] = {
    R"(agent: "lstm_cnn")",
    R"(agent: "oc_sa" network { frame_size: 32 patch: 4 stride: 4 })",
    R"(agent: "oc_ca" network { frame_size: 24 patch: 4 stride: 4 residual_mlp: true layer_norm: true })",
};
constexpr int kRows = 8;   // the default tile
constexpr int kSteps = 2;  // of the LSTM

struct Known {
  absl::string_view libtorch;
  v1::RunConfig::Cpu cpu;
  absl::string_view canary;
};
constexpr Known kKnown[] = {
    {"1.13.0", v1::RunConfig::AVX2, "a52cfea04acefeb7"},  // Debian 12, with oneDNN 2.6.3
};

// The `index`th of endless numbers in [-1, 1) that are multiples of 2^-23: the same on every machine.
float Number(uint64_t stream, uint64_t index) {
  const uint64_t bits = MixBits(stream * 0x9E3779B97F4A7C15ULL + index);
  return static_cast<float>(static_cast<int32_t>(bits >> 40) - (1 << 23)) * 0x1p-23F;
}

// Keeps outputs in range: each weight is within +-2 / sqrt(inputs).
std::vector<float> CanaryWeights(const AgentSpec& spec) {
  std::vector<float> weights(spec.param_count);
  for (const ParamSpec& param : spec.params) {
    const int64_t inputs = param.shape.size() > 1 ? param.size / param.shape[0] : 16;
    const float scale = 2.0F / std::sqrt(static_cast<float>(inputs));
    for (int64_t i = param.offset; i < param.offset + param.size; ++i) weights[i] = scale * Number(1, i);
  }
  return weights;
}

at::Tensor CanaryFrames(int size, int step) {
  at::Tensor frames = at::empty({kRows, size, size, 3});
  float* values = frames.data_ptr<float>();
  for (int64_t i = 0; i < frames.numel(); ++i) values[i] = std::abs(Number(2 + step, i));
  return frames;
}

uint64_t TakeIn(uint64_t hash, const at::Tensor& tensor) {
  const at::Tensor values = tensor.contiguous();
  return Fnv1a(hash, {static_cast<const char*>(values.data_ptr()), static_cast<size_t>(values.nbytes())});
}

uint64_t TakeInNetwork(uint64_t hash, const AgentSpec& spec) {
  std::vector<float> weights = CanaryWeights(spec);
  const PolicyNet net(spec, PolicyNet::Use::kActing, absl::MakeSpan(weights));
  Segments segments = {std::vector<int>(kRows, 1), at::zeros({kRows, spec.state_size})};
  for (int step = 0; step < kSteps; ++step) {
    const PolicyNet::Output output = net.Forward(CanaryFrames(spec.frame_size, step), segments);
    const at::Tensor odds = at::softmax(output.logits, /*dim=*/1);
    for (const at::Tensor& tensor : {output.logits, output.values, odds}) hash = TakeIn(hash, tensor);
    if (spec.state_size == 0) break;
    hash = TakeIn(hash, output.states);
    segments.states = output.states;
  }
  return hash;
}

absl::StatusOr<std::string> Compute() {
  SetUpTorchThread();
  uint64_t hash = kFnv1aBasis;
  for (const char* text : kNetworks) {
    v1::RunConfig config;
    CRAFTFLEET_CHECK(google::protobuf::TextFormat::ParseFromString(text, &config));
    CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
    try {
      const c10::InferenceMode inference;
      hash = TakeInNetwork(hash, spec);
    } catch (const std::exception& error) {
      return absl::InternalError(absl::StrCat("the canary of ", spec.name, ": ", error.what()));
    }
  }
  return absl::StrFormat("%016x", hash);
}

}  // namespace

absl::StatusOr<std::string> PolicyCanary() {
  static const auto& canary = *new absl::StatusOr<std::string>(Compute());
  return canary;
}

absl::string_view KnownPolicyCanary(v1::RunConfig::Cpu cpu) {
  for (const Known& known : kKnown) {
    if (known.cpu == cpu && known.libtorch == TORCH_VERSION) return known.canary;
  }
  return "";
}

}  // namespace craftfleet
