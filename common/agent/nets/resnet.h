// The residual network of Moon et al. 2023. No LibTorch here.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_RESNET_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_RESNET_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/types/optional.h>

#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"

namespace craftfleet {

// Frames to 1,024 features: three stacks of 64, 128 and 128 channels, each halving width and height, then two linear
// layers. Source: "The agents", section 9.
class Resnet : public Part {
 public:
  static constexpr int64_t kFeatures = 1024;

  Resnet(const std::string& name, int64_t frame_size, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                     const absl::optional<Dropout>& dropout) const override;

 private:
  // Normalises its input, convolves 3x3 or multiplies, ReLU. `name`.norm and `name`.layer.
  class NormedConv {
   public:
    // `normed`: false for the network's first layer, which has a bias instead.
    NormedConv(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, bool normed,
               ParamList* params);
    at::Tensor Forward(const ParamTensors& params, const at::Tensor& map) const;

   private:
    absl::optional<NormLayer> norm_;
    ConvLayer conv_;
  };
  class NormedLinear {
   public:
    NormedLinear(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, ParamList* params);
    at::Tensor Forward(const ParamTensors& params, const at::Tensor& features) const;

   private:
    NormLayer norm_;
    LinearLayer linear_;
  };
  struct Block {
    NormedConv first, second;  // added to the block's input
  };
  struct Stack {
    NormedConv first;
    NormLayer norm;  // after pooling
    std::vector<Block> blocks;
  };

  std::vector<Stack> stacks_;
  std::vector<NormedLinear> linears_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_RESNET_H_
