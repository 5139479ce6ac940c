// The network of an agent with its weights, on LibTorch. Include it only where tensors are at home; acting goes through
// common/agent/policy.h.

#ifndef CRAFTFLEET_COMMON_AGENT_POLICY_NET_H_
#define CRAFTFLEET_COMMON_AGENT_POLICY_NET_H_

#include <cstdint>
#include <vector>

#include <ATen/core/Tensor.h>
#include <absl/types/optional.h>
#include <absl/types/span.h>
#include <c10/core/Device.h>

#include "common/agent/agent_spec.h"
#include "common/agent/nets/network.h"
#include "common/agent/nets/param_tensors.h"
#include "common/agent/nets/segments.h"

namespace craftfleet {

// Computes on weights that lie in someone else's flat array (AgentSpec's order), so that replicas share them and an
// optimiser writes them in place; a net on a GPU copies them there at each Forward. What goes in and comes out is on
// the CPU. Thread-compatible; without gradients, several threads may call Forward. Source: Stanic et al. 2022; "The
// agents"; goldens agents/*.json.
class PolicyNet {
 public:
  enum class Use {
    kActing,    // the weights never change: they are copied into the layout that is quickest to read
    kTraining,  // the weights may change between calls; Forward's output is good for one backward pass
  };
  using Output = NetOutput;

  // `weights`, float[spec.param_count], outlive the net, which computes on `device`; acting, on the CPU alone. "cpu:0"
  // is the CPU with the copies that a GPU wants, for tests.
  PolicyNet(const AgentSpec& spec, Use use, absl::Span<float> weights, at::Device device = at::kCPU);

  // frames float[N,H,W,3], values 0..1. `segments` say how the rows follow each other; feed-forward agents ignore them.
  // In training, `dropout` decides what attention drops: `key` from the run's seed and the minibatch's number,
  // `first_row` where these rows begin in the minibatch, so that shards drop what the whole would. Acting gives none.
  Output Forward(const at::Tensor& frames, const Segments& segments = {},
                 const absl::optional<Dropout>& dropout = absl::nullopt) const;

  // frames as above -> float[N,views,patches]: how much each view attends to each patch (nets/part.h). Only for agents
  // with an object module.
  at::Tensor Attention(const at::Tensor& frames) const;

  // Training: the gradient of each parameter since the last ClearGradients, in the spec's order. The spans hold until
  // the next backward pass or ClearGradients.
  std::vector<absl::Span<float>> gradients();
  void ClearGradients();

 private:
  bool elsewhere() const { return device_ != at::Device(at::kCPU); }
  Output ForwardElsewhere(const at::Tensor& frames, const Segments& segments,
                          const absl::optional<Dropout>& dropout) const;

  const at::Device device_;
  ParamTensors params_;
  Network network_;
  // Elsewhere: the weights here and there, float[param_count], and the gradients as they came back.
  at::Tensor host_weights_, device_weights_, host_gradients_;
};

// Frames as the net wants them: `out` is float[n,H,W,3] in 0..1, each of `frames` points to `frame_bytes` bytes.
void ScaleFrames(absl::Span<const uint8_t* const> frames, int64_t frame_bytes, float* out);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_POLICY_NET_H_
