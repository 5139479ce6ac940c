// The layers that networks are made of. Each declares its parameters when it is made and computes with them later; the
// header needs LibTorch's names alone, so that listing an agent's parameters compiles quickly.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_LAYERS_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_LAYERS_H_

#include <cstdint>
#include <string>

#include <ATen/core/ATen_fwd.h>

#include "common/agent/nets/params.h"

namespace craftfleet {

struct ParamTensors;

// How a layer's weight starts where nothing else is said: orthogonal, gain sqrt(2).
constexpr ParamInit kHiddenInit = {ParamInit::Kind::kOrthogonal, 1.4142135623730951};

enum class Bias { kNone, kZero, kLikeWeight };  // whether there is one, and how it starts

// `name`.weight [out,in] and `name`.bias [out].
class LinearLayer {
 public:
  LinearLayer(const std::string& name, int64_t inputs, int64_t outputs, ParamInit init, Bias bias, ParamList* params);

  // input float[...,in] -> float[...,out].
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input) const;

 private:
  ParamIndex weight_;
  ParamIndex bias_;
};

// `name`.weight [out,in,kernel,kernel] and `name`.bias [out].
class ConvLayer {
 public:
  struct Shape {
    int64_t inputs;   // channels
    int64_t outputs;  // likewise
    int64_t kernel;   // pixels, width and height
    int64_t stride;
    int64_t padding;  // zeros around the input
  };
  ConvLayer(const std::string& name, const Shape& shape, ParamInit init, Bias bias, ParamList* params);

  // input float[N,in,H,W] -> float[N,out,H',W'].
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input) const;

 private:
  Shape shape_;
  ParamIndex weight_;
  ParamIndex bias_;
};

// Normalises each row over all its values, then scales and shifts: `name`.weight starts at 1, `name`.bias at 0.
class NormLayer {
 public:
  enum class Over { kFeatures, kMap };  // LayerNorm of [...,size]; GroupNorm with one group of [N,size,H,W]

  NormLayer(const std::string& name, int64_t size, Over over, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input) const;

 private:
  int64_t size_;
  Over over_;
  ParamIndex weight_;
  ParamIndex bias_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_LAYERS_H_
