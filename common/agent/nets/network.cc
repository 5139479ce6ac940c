#include "common/agent/nets/network.h"

#include <numeric>
#include <optional>
#include <utility>

#include <ATen/ATen.h>

#include "common/agent/nets/attention.h"
#include "common/agent/nets/convolutions.h"
#include "common/agent/nets/cross_attention.h"
#include "common/agent/nets/grid_resnet.h"
#include "common/agent/nets/param_tensors.h"
#include "common/agent/nets/prepared_weights.h"
#include "common/agent/nets/resnet.h"
#include "common/agent/nets/segments.h"
#include "common/agent/nets/self_attention.h"
#include "common/base/check.h"
#include "common/base/crafter.h"

namespace craftfleet {
namespace {

constexpr int64_t kFeatures = 512;  // of a map that ends in a linear layer

ParamInit Orthogonal(double gain) { return {ParamInit::Kind::kOrthogonal, gain}; }

}  // namespace

Network::Network(const v1::NetworkConfig& config, ParamList* params) {
  features_ = AddExtractor(config, params);
  const bool is_residual =
      config.extractor() == v1::NetworkConfig::RESNET || config.extractor() == v1::NetworkConfig::GRID_RESNET;
  if (config.memory()) memory_size_ = features_;
  const int64_t head_inputs = config.recurrent() ? LstmLayer::kHidden : features_ + memory_size_;
  action_net_.emplace("action_net", head_inputs, kNumActions, Orthogonal(0.01), Bias::kZero, params);
  value_net_.emplace("value_net", head_inputs, 1, Orthogonal(is_residual ? 0.1 : 1), Bias::kZero, params);
  if (config.recurrent()) {
    const bool lstm_critic = config.critic() == v1::NetworkConfig::LSTM;
    core_.emplace(features_, lstm_critic ? RecurrentCore::Critic::kLstm : RecurrentCore::Critic::kLinear, params);
  }
  // Last, since updates by PPO leave it alone.
  if (config.goal_predictor()) goal_predictor_.emplace(features_, memory_size_, params);
}

int64_t Network::AddExtractor(const v1::NetworkConfig& config, ParamList* params) {
  const std::string name = "features_extractor";
  if (config.extractor() == v1::NetworkConfig::RESNET) {
    parts_.push_back(std::make_unique<Resnet>(name, config.frame_size(), config.width(), params));
    return Resnet::kFeatures;
  }
  if (config.extractor() == v1::NetworkConfig::GRID_RESNET) {
    parts_.push_back(std::make_unique<GridResnet>(name, config.frame_size(), config.width(), params));
    return GridResnet::kFeatures;
  }
  if (config.objects() != v1::NetworkConfig::NO_OBJECTS) {
    parts_.push_back(std::make_unique<Convolutions>(
        Convolutions::SizePreserving(name + ".precnn.cnn", config.frame_size(), params)));
    std::unique_ptr<AttentionPart> objects = MakeObjectModule(config, name + ".rsn", params);
    attention_ = objects.get();
    parts_.push_back(std::move(objects));
    return kAttentionWidth;
  }
  int64_t size = config.frame_size();
  if (config.extractor() == v1::NetworkConfig::SPCNN) {
    parts_.push_back(std::make_unique<Convolutions>(Convolutions::SizePreserving(name + ".cnn.cnn", size, params)));
  } else {
    parts_.push_back(std::make_unique<Convolutions>(Convolutions::Dqn(name + ".cnn", params)));
    size = Convolutions::DqnOutputSize(size);
  }
  const int64_t map_values = Convolutions::kChannels * size * size;
  parts_.push_back(std::make_unique<FlattenLinear>(name + ".outmap.0", map_values, kFeatures, params));
  return kFeatures;
}

std::unique_ptr<AttentionPart> Network::MakeObjectModule(const v1::NetworkConfig& config, const std::string& name,
                                                         ParamList* params) {
  if (config.objects() == v1::NetworkConfig::SELF_ATTENTION) {
    return std::make_unique<SelfAttention>(name, config, params);
  }
  return std::make_unique<CrossAttention>(name, config, params);
}

std::shared_ptr<const PreparedWeights> Network::Prepare(const ParamTensors& params, bool for_gradients,
                                                        const RunTasks& run) const {
  Preparation preparation;
  preparation.for_gradients = for_gradients;
  for (const std::unique_ptr<Part>& part : parts_) part->Prepare(params, &preparation);
  run(preparation.tasks);
  return std::make_shared<const PreparedWeights>(std::move(preparation.weights));
}

at::Tensor Network::Features(const ParamTensors& params, const at::Tensor& frames,
                             const std::optional<Dropout>& dropout) const {
  // Channels last without a copy: oneDNN accepts this layout.
  at::Tensor x = frames.permute({0, 3, 1, 2});
  for (const std::unique_ptr<Part>& part : parts_) x = part->Forward(params, x, dropout);
  return x;
}

NetOutput Network::Forward(const ParamTensors& params, const at::Tensor& frames, const Segments& segments,
                           const std::optional<Dropout>& dropout) const {
  at::Tensor actor_features = Features(params, frames, dropout);
  at::Tensor critic_features = actor_features;
  NetOutput output;
  if (core_.has_value()) {
    const int64_t rows = std::accumulate(segments.lengths.begin(), segments.lengths.end(), int64_t{0});
    const bool is_padded = rows < actor_features.size(0);
    const at::Tensor features = is_padded ? actor_features.narrow(0, 0, rows) : actor_features;
    core_->Forward(params, features, segments, &actor_features, &critic_features, &output.states);
  }
  output.codes = actor_features;
  if (segments.actions.defined()) {
    CRAFTFLEET_CHECK(goal_predictor_.has_value());
    output.predictions = goal_predictor_->Forward(params, actor_features, segments.actions, segments.states);
  }
  if (memory_size_ > 0) {
    actor_features = critic_features = at::cat({actor_features, segments.states}, 1);
    output.states = segments.states;
  }
  output.logits = action_net_->Forward(params, actor_features);
  output.values = value_net_->Forward(params, critic_features).squeeze(1);
  return output;
}

at::Tensor Network::Attention(const ParamTensors& params, const at::Tensor& frames) const {
  CRAFTFLEET_CHECK(attention_ != nullptr);
  at::Tensor x = frames.permute({0, 3, 1, 2});
  for (const std::unique_ptr<Part>& part : parts_) {
    if (part.get() == attention_) break;
    x = part->Forward(params, x, std::nullopt);
  }
  return attention_->Attention(params, x);
}

}  // namespace craftfleet
