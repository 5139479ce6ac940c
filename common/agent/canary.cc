#include "common/agent/canary.h"

#include <cmath>
#include <cstdint>
#include <exception>
#include <vector>

#include <ATen/ATen.h>
#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/types/span.h>
#include <google/protobuf/text_format.h>
#include <torch/version.h>

#include "common/agent/agent_spec.h"
#include "common/agent/device.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/base/check.h"
#include "common/base/fnv1a.h"
#include "common/base/seeds.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

struct Computation {
  const char* network;
  int rows;
};
constexpr int kTile = 8;  // the default
// Small networks that together use the layers which canary.h lists, with convolutions by FFT with both sizes of tiles.
// Changing them changes every canary.
constexpr Computation kComputations[] = {
    {R"(agent: "lstm_cnn")", kTile},
    {R"(agent: "oc_sa" network { frame_size: 32 patch: 4 stride: 4 })", kTile},
    {R"(agent: "oc_ca" network { frame_size: 24 patch: 4 stride: 4 residual_mlp: true layer_norm: true })", kTile},
};
// What bfloat16 adds: LibTorch's products, of a tile and of a shard of a minibatch, whose many numbers show rare
// differences; and those of a linear layer that has kernels of its own from 32 rows on (nets/wide_product.h).
constexpr Computation kBf16Computations[] = {
    {R"(agent: "ppo_cnn" network { frame_size: 36 } precision: BF16)", kTile},
    {R"(agent: "ppo_cnn" network { frame_size: 36 } precision: BF16)", 64},
    {R"(agent: "ppo_spcnn" network { frame_size: 24 } precision: BF16)", 32},
};
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

at::Tensor CanaryFrames(int rows, int size, int step) {
  at::Tensor frames = at::empty({rows, size, size, 3});
  float* values = frames.data_ptr<float>();
  for (int64_t i = 0; i < frames.numel(); ++i) values[i] = std::abs(Number(2 + step, i));
  return frames;
}

uint64_t TakeIn(uint64_t hash, const at::Tensor& tensor) {
  const at::Tensor values = tensor.contiguous();
  return Fnv1a(hash, {static_cast<const char*>(values.data_ptr()), static_cast<size_t>(values.nbytes())});
}

uint64_t TakeInNetwork(uint64_t hash, const AgentSpec& spec, int rows) {
  std::vector<float> weights = CanaryWeights(spec);
  const PolicyNet net(spec, PolicyNet::Use::kActing, absl::MakeSpan(weights));
  Segments segments = {std::vector<int>(rows, 1), at::zeros({rows, spec.state_size})};
  for (int step = 0; step < kSteps; ++step) {
    const PolicyNet::Output output = net.Forward(CanaryFrames(rows, spec.frame_size, step), segments);
    const at::Tensor odds = at::softmax(output.logits, /*dim=*/1);
    for (const at::Tensor& tensor : {output.logits, output.values, odds}) hash = TakeIn(hash, tensor);
    if (spec.state_size == 0) break;
    hash = TakeIn(hash, output.states);
    segments.states = output.states;
  }
  return hash;
}

absl::StatusOr<uint64_t> TakeInNetworks(uint64_t hash, absl::Span<const Computation> computations) {
  SetUpTorchThread();
  for (const Computation& computation : computations) {
    v1::RunConfig config;
    CRAFTFLEET_CHECK(google::protobuf::TextFormat::ParseFromString(computation.network, &config));
    CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
    try {
      const c10::InferenceMode inference;
      hash = TakeInNetwork(hash, spec, computation.rows);
    } catch (const std::exception& error) {
      return absl::InternalError(absl::StrCat("the canary of ", spec.name, ": ", error.what()));
    }
  }
  return hash;
}

absl::StatusOr<std::string> Compute(bool takes_in_bf16) {
  CRAFTFLEET_ASSIGN_OR_RETURN(uint64_t hash, TakeInNetworks(kFnv1aBasis, kComputations));
  if (takes_in_bf16) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckPrecision("cpu", v1::RunConfig::BF16));
    CRAFTFLEET_ASSIGN_OR_RETURN(hash, TakeInNetworks(hash, kBf16Computations));
  }
  return absl::StrFormat("%016x", hash);
}

}  // namespace

absl::StatusOr<std::string> PolicyCanary(const v1::RunConfig& run) {
  if (run.precision() == v1::RunConfig::BF16 && run.device() != v1::RunConfig::CUDA) {
    static const auto& canary = *new absl::StatusOr<std::string>(Compute(/*takes_in_bf16=*/true));
    return canary;
  }
  static const auto& canary = *new absl::StatusOr<std::string>(Compute(/*takes_in_bf16=*/false));
  return canary;
}

absl::string_view KnownPolicyCanary(v1::RunConfig::Cpu cpu) {
  for (const Known& known : kKnown) {
    if (known.cpu == cpu && known.libtorch == TORCH_VERSION) return known.canary;
  }
  return "";
}

}  // namespace craftfleet
