// A whole network: feature extractor, optional object-centric module, optional recurrent core, two heads. Does not
// include LibTorch.

#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/agent/nets/goal_predictor.h"
#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"
#include "common/agent/nets/recurrent_core.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

struct NetOutput;
struct PreparedWeights;
struct Segments;

// Runs independent tasks and returns when all of them have ended.
using RunTasks = std::function<void(const std::vector<std::function<void()>>&)>;

// Declares parameters and computes with them, but does not hold them. Immutable and thread-safe.
// Source: Stanic et al. 2022; AGENTS.md.
class Network {
 public:
  // `config` comes from ResolveNetwork. Adds the network's parameters to `params`, in the order of saved weights.
  Network(const v1::NetworkConfig& config, ParamList* params);

  // Floats of state: recurrent, or the memory; 0: none.
  int64_t state_size() const { return core_.has_value() ? core_->state_size() : memory_size_; }

  // F: floats of features.
  int64_t feature_size() const { return features_; }

  // What the parts compute from the weights alone. `for_gradients`: also what a backward pass needs.
  std::shared_ptr<const PreparedWeights> Prepare(const ParamTensors& params, bool for_gradients,
                                                 const RunTasks& run) const;

  // frames float[N,H,W,3], values 0..1 -> float[N,F]: the input of core or heads.
  at::Tensor Features(const ParamTensors& params, const at::Tensor& frames,
                      const std::optional<Dropout>& dropout) const;

  // frames as above. `segments` are used by networks with a state, and for distillation; behind their rows a recurrent
  // network's frames may have more, which have no outputs.
  NetOutput Forward(const ParamTensors& params, const at::Tensor& frames, const Segments& segments,
                    const std::optional<Dropout>& dropout) const;

  // frames as above -> float[N,views,patches]: see AttentionPart. Only for networks with an object module.
  at::Tensor Attention(const ParamTensors& params, const at::Tensor& frames) const;

 private:
  // Appends the parts between frames and features; returns the number of features.
  int64_t AddExtractor(const v1::NetworkConfig& config, ParamList* params);
  static std::unique_ptr<AttentionPart> MakeObjectModule(const v1::NetworkConfig& config, const std::string& name,
                                                         ParamList* params);

  int64_t features_ = 0;
  std::vector<std::unique_ptr<Part>> parts_;  // from the frames' map to features
  const AttentionPart* attention_ = nullptr;  // of parts_, if there is one
  std::optional<LinearLayer> action_net_;
  std::optional<LinearLayer> value_net_;
  std::optional<RecurrentCore> core_;
  int64_t memory_size_ = 0;  // floats beside the features that heads and predictor see
  std::optional<GoalPredictor> goal_predictor_;
};

}  // namespace craftfleet
