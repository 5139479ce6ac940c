#include "common/agent/nets/network.h"

#include <string>

#include <ATen/ATen.h>

#include "common/agent/nets/convolutions.h"
#include "common/agent/nets/param_tensors.h"
#include "common/agent/nets/segments.h"
#include "common/crafter.h"

namespace craftfleet {
namespace {

constexpr int64_t kFeatures = 512;  // of the extractors that end in a linear layer
const char kExtractor[] = "features_extractor";

// How the heads' weights start.
ParamInit HeadInit(double gain) { return {ParamInit::Kind::kOrthogonal, gain}; }

}  // namespace

Network::Network(const v1::NetworkConfig& config, ParamList* params) {
  const std::string name = kExtractor;
  int64_t features = kFeatures;
  const int64_t size = config.frame_size();
  switch (config.extractor()) {
    case v1::NetworkConfig::SPCNN: {
      parts_.push_back(std::make_unique<Convolutions>(Convolutions::SizePreserving(name + ".cnn.cnn", params)));
      parts_.push_back(std::make_unique<FlattenLinear>(name + ".outmap.0", Convolutions::kChannels * size * size,
                                                       kFeatures, params));
      break;
    }
    default: {
      const int64_t map_size = Convolutions::DqnOutputSize(size);
      parts_.push_back(std::make_unique<Convolutions>(Convolutions::Dqn(name + ".cnn", params)));
      parts_.push_back(std::make_unique<FlattenLinear>(
          name + ".outmap.0", Convolutions::kChannels * map_size * map_size, kFeatures, params));
    }
  }
  const int64_t head_inputs = config.recurrent() ? LstmLayer::kHidden : features;
  action_net_.emplace("action_net", head_inputs, kNumActions, HeadInit(0.01), Bias::kZero, params);
  value_net_.emplace("value_net", head_inputs, 1, HeadInit(1), Bias::kZero, params);
  if (config.recurrent()) {
    const bool lstm_critic = config.critic() == v1::NetworkConfig::LSTM;
    core_.emplace(features, lstm_critic ? RecurrentCore::Critic::kLstm : RecurrentCore::Critic::kLinear, params);
  }
}

NetOutput Network::Forward(const ParamTensors& params, const at::Tensor& frames, const Segments& segments,
                           const absl::optional<Dropout>& dropout) const {
  // Channels last without a copy: oneDNN takes frames as they lie.
  at::Tensor x = frames.permute({0, 3, 1, 2});
  for (const std::unique_ptr<Part>& part : parts_) x = part->Forward(params, x, dropout);
  at::Tensor actor_features = x;
  at::Tensor critic_features = x;
  NetOutput output;
  if (core_.has_value()) {
    core_->Forward(params, x, segments, &actor_features, &critic_features, &output.states);
  }
  output.logits = action_net_->Forward(params, actor_features);
  output.values = value_net_->Forward(params, critic_features).squeeze(1);
  return output;
}

}  // namespace craftfleet
