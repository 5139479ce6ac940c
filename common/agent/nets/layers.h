// The layers of networks. Each declares its parameters in its constructor and computes with them later. The header
// needs only forward declarations of LibTorch, so that code that lists an agent's parameters compiles quickly.

#pragma once

#include <cstdint>
#include <string>

#include <ATen/core/ATen_fwd.h>

#include "common/agent/nets/params.h"

namespace craftfleet {

struct DirectShape;
struct ParamTensors;
struct Preparation;
struct PreparedWeight;

// The default initialisation of a layer's weight: orthogonal, gain sqrt(2).
constexpr ParamInit kHiddenInit = {ParamInit::Kind::kOrthogonal, 1.4142135623730951};

enum class Bias { kNone, kZero, kLikeWeight };  // whether there is a bias, and its initialisation

// `name`.weight [out,in] and `name`.bias [out].
class LinearLayer {
 public:
  LinearLayer(const std::string& name, int64_t inputs, int64_t outputs, ParamInit init, Bias bias, ParamList* params);

  // input float[...,in] -> float[...,out], multiplied as `params` say.
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input) const;

  // As Part::Prepare, for Forward.
  void Prepare(const ParamTensors& params, Preparation* preparation) const;

  // The patches of a map (CutPatches), each followed by its row of `tail`, float[patches,in - C patch^2], unless that
  // is undefined: map float[N,C,S,S] -> float[N,patches,out]. A convolution wherever that is quicker.
  at::Tensor ForwardPatches(const ParamTensors& params, const at::Tensor& map, int64_t patch, int64_t stride,
                            const at::Tensor& tail) const;

  // As Part::Prepare, for ForwardPatches on maps of `channels` channels and `size` pixels a side.
  void PreparePatches(const ParamTensors& params, int64_t channels, int64_t size, int64_t patch, int64_t stride,
                      Preparation* preparation) const;

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

  // input [N,in,H,W] -> [N,out,H',W'], of the type that `params` are multiplied as.
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input) const;

  // The same with a ReLU and without LibTorch, in float32, where this CPU and FftConvolution or DirectConvolution fit.
  at::Tensor ForwardRelu(const ParamTensors& params, const at::Tensor& input) const;

  // As Part::Prepare, for ForwardRelu on maps of `size` pixels a side.
  void Prepare(const ParamTensors& params, int64_t size, Preparation* preparation) const;

 private:
  // What computes maps of this size.
  enum class Kernels { kLibTorch, kFft, kDirect };
  Kernels KernelsFor(const ParamTensors& params, int64_t size) const;
  // Frames need no gradient.
  bool sees_frames() const { return shape_.inputs == 3; }
  DirectShape DirectShapeFor(int64_t size) const;
  // Room for the prepared weight, and what fills it.
  PreparedWeight Allocate(Kernels kernels, int64_t size, bool for_gradients) const;
  void Fill(Kernels kernels, int64_t size, const at::Tensor& weight, const PreparedWeight& prepared) const;

  Shape shape_;
  ParamIndex weight_;
  ParamIndex bias_;
};

// Normalises each row over all its values, then scales and shifts, in float32: `name`.weight starts at 1, `name`.bias
// at 0.
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

// A weight whose rows start as uniform numbers, each row scaled to the L2 norm `norm`.
constexpr ParamInit RowNorm(double norm) { return {ParamInit::Kind::kRowNorm, norm}; }

// Normalises its input, multiplies, ReLU: `name`.norm and `name`.layer, whose rows start with the L2 norm `row_norm`.
// Source: Moon et al. 2023.
class NormedLinear {
 public:
  NormedLinear(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, ParamList* params);

  // input float[N,in] -> float[N,out], at least 0.
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input) const;

 private:
  NormLayer norm_;
  LinearLayer linear_;
};

}  // namespace craftfleet
