// A whole network: feature extractor, optional object-centric module, optional recurrent core, two heads. No LibTorch
// here.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_NETWORK_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_NETWORK_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <absl/types/optional.h>

#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"
#include "common/agent/nets/recurrent_core.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

struct NetOutput;
struct Segments;

// Knows its parameters and how to compute with them, but does not hold them. Immutable and thread-safe.
// Source: Stanic et al. 2022; "The agents", sections 3 to 6 and 9.
class Network {
 public:
  // `config` comes from ResolveNetwork. Adds the network's parameters to `params`, in the order of saved weights.
  Network(const v1::NetworkConfig& config, ParamList* params);

  // Floats of recurrent state; 0: feed-forward.
  int64_t state_size() const { return core_.has_value() ? core_->state_size() : 0; }

  // frames float[N,H,W,3], values 0..1 -> float[N,F]: what core or heads get.
  at::Tensor Features(const ParamTensors& params, const at::Tensor& frames,
                      const absl::optional<Dropout>& dropout) const;

  // frames as above. `segments` count for recurrent networks alone.
  NetOutput Forward(const ParamTensors& params, const at::Tensor& frames, const Segments& segments,
                    const absl::optional<Dropout>& dropout) const;

  // frames as above -> float[N,views,patches]: see AttentionPart. Only for networks with an object module.
  at::Tensor Attention(const ParamTensors& params, const at::Tensor& frames) const;

 private:
  // Appends the parts between frames and features; returns how many features there are.
  int64_t AddExtractor(const v1::NetworkConfig& config, ParamList* params);
  static std::unique_ptr<AttentionPart> MakeObjectModule(const v1::NetworkConfig& config, const std::string& name,
                                                         ParamList* params);

  std::vector<std::unique_ptr<Part>> parts_;  // from the frames' map to features
  const AttentionPart* attention_ = nullptr;  // of parts_, if there is one
  absl::optional<LinearLayer> action_net_;
  absl::optional<LinearLayer> value_net_;
  absl::optional<RecurrentCore> core_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_NETWORK_H_
