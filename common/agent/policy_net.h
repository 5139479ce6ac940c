// The network of an agent with its weights, on LibTorch. Includes LibTorch's tensors; acting goes through
// common/agent/policy.h.

#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include <ATen/core/Tensor.h>
#include <absl/types/span.h>
#include <c10/core/Device.h>

#include "common/agent/agent_spec.h"
#include "common/agent/nets/network.h"
#include "common/agent/nets/param_tensors.h"
#include "common/agent/nets/segments.h"

namespace craftfleet {

// The network of `config`, complete (AgentSpec::network).
Network MakeNetwork(const v1::NetworkConfig& config);

// Views of `weights`, float[spec.param_count] on any device, as the parameters of the agent's network.
ParamTensors ParamsOf(const AgentSpec& spec, const at::Tensor& weights);

// `values`, float[n], on `device`. Waits for the copy. Throws c10::Error.
at::Tensor SendFloats(const std::vector<float>& values, at::Device device);

// Computes on weights in a flat array that it does not own (AgentSpec's order), so that replicas share them and an
// optimiser writes them in place. Thread-compatible; without gradients, several threads may call Forward. Source:
// Stanic et al. 2022; AGENTS.md; goldens in tests/data/agents.
class PolicyNet {
 public:
  enum class Use {
    kActing,    // the weights never change: they are brought into the layout that is quickest to read
    kTraining,  // the weights may change between calls; Forward's output is valid for one backward pass
  };
  using Output = NetOutput;

  // On the CPU: `weights`, float[spec.param_count], outlive the net.
  PolicyNet(const AgentSpec& spec, Use use, absl::Span<float> weights);

  // For acting on `params`, which never change, on their device, where inputs and outputs are, too.
  PolicyNet(const AgentSpec& spec, ParamTensors params);

  // frames float[N,H,W,3], values 0..1. `segments` tell how the rows follow each other; feed-forward agents ignore
  // them. In training, `dropout` decides what attention drops: `key` from the run's seed and the minibatch's number,
  // `first_row` where these rows begin in the minibatch, so that shards drop the same weights as the whole. Acting
  // passes none.
  Output Forward(const at::Tensor& frames, const Segments& segments = {},
                 const std::optional<Dropout>& dropout = std::nullopt) const;

  // frames as above -> float[N,F]: what the heads see of them, without memory or recurrence; on the net's own device.
  at::Tensor Codes(const at::Tensor& frames) const;

  // frames as above -> float[N,views,patches]: how much each view attends to each patch (nets/part.h). Only for agents
  // with an object module.
  at::Tensor Attention(const at::Tensor& frames) const;

  // Training: what the network computes from the present weights alone, shared out by `run`. Replicas on the same
  // weights get it with UsePrepared, until the weights change; nullptr: each pass computes it again.
  std::shared_ptr<const PreparedWeights> Prepare(const RunTasks& run) const;
  void UsePrepared(std::shared_ptr<const PreparedWeights> prepared) { params_.prepared = std::move(prepared); }

  // Training: the gradient of each parameter since the last ClearGradients, in the spec's order, without those of the
  // last parameters that no backward pass has reached (a goal predictor's). The spans hold until the next backward pass
  // or ClearGradients.
  std::vector<absl::Span<float>> gradients();
  void ClearGradients();

  // Training: whether backward passes leave the gradients of the weights that WideLinear multiplies as factors;
  // gradients() then has empty spans for them. Factors are kept until ClearGradients.
  void LeaveWideGradients(bool leaves);
  // Undefined for a weight that is as large, but that WideLinear does not multiply.
  const std::map<ParamIndex, c10::intrusive_ptr<WideFactors>>& wide_factors() const { return params_.wide_factors; }

 private:
  // Brings the weights into the layout that is quickest to read.
  void PrepareForActing();

  ParamTensors params_;
  Network network_;
};

// Frames as the net wants them: `out` is float[n,H,W,3] in 0..1, each of `frames` points to `frame_bytes` bytes.
void ScaleFrames(absl::Span<const uint8_t* const> frames, int64_t frame_bytes, float* out);

// The same of frames uint8[N,H,W,3] on a device.
at::Tensor ScaleFrames(const at::Tensor& frames);

}  // namespace craftfleet
