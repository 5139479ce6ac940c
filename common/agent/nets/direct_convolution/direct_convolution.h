// A convolution of square maps whose pixels lie side by side, float[n][size][size][channels], computed as one product:
// what an output pixel sees of one input row is one stretch of memory. For layers that FftConvolution does not fit:
// few channels, or windows far apart (patches).
//
// With p the place where an output pixel's window begins, and k a place in the window,
//     Y[p, o] = sum over k of X[p + k] W[k, o],   X'[p + k] = sum over p and o of Y'[p, o] W[k, o],
//     W'[k, o] = sum over p of X[p + k] Y'[p, o].
// An output depends on nothing but its window and the weights: not on the other maps, the number of threads or the
// instruction set.

#pragma once

#include <cstdint>
#include <vector>

#include "common/agent/nets/direct_convolution/kernels.h"

namespace craftfleet {

struct DirectShape {
  int64_t channels;  // of the input
  int64_t outputs;   // channels of the output: a multiple of 64
  int64_t kernel;    // pixels a side
  int64_t stride;
  int64_t padding;  // zeros around the input
  int64_t size;     // pixels of the input, a side

  int64_t output_size() const { return (size + 2 * padding - kernel) / stride + 1; }
};

// Immutable and thread-safe. Arrays of floats are aligned to 64 bytes, but for weight and bias.
class DirectConvolution {
 public:
  // Whether this CPU has the kernels and they compute `shape`, with its gradients: that with respect to the input needs
  // no padding and a multiple of 64 numbers in a row of a window.
  static bool Fits(const DirectShape& shape, bool wants_input_gradient);

  // Fits(shape, ..) is true.
  explicit DirectConvolution(const DirectShape& shape)
      : shape_(shape), kernels_(*FindDirectKernels(CurrentCpuPath())) {}

  int64_t weight_floats() const { return window() * shape_.outputs; }
  // Bytes of the mask of n maps: one bit an output.
  int64_t mask_bytes(int64_t n) const { return n * pixels() * shape_.outputs / 8; }

  enum class Use { kOutput, kInputGradient };
  // weight[out][in][kernel][kernel] -> the panels, float[weight_floats()], that Forward (kOutput) or Backward read.
  void ArrangeWeight(const float* weight, Use use, float* panels) const;

  // output = input * weight + bias, float[n][output_size][output_size][outputs]; with a mask, which Backward needs,
  // also max(.., 0).
  void Forward(int64_t n, const float* input, const float* panels, const float* bias, float* output,
               uint8_t* mask) const;

  struct Gradients {
    float* input;   // as the input; null: not wanted
    float* weight;  // [out][in][kernel][kernel]
    float* bias;    // [outputs]
  };
  // `mask`: as Forward's. `panels`: null where the input's gradient is not wanted.
  void Backward(int64_t n, const float* output_gradient, const uint8_t* mask, const float* input, const float* panels,
                const Gradients& gradients) const;

 private:
  // Output pixels of a map, and numbers in a window.
  int64_t pixels() const { return shape_.output_size() * shape_.output_size(); }
  int64_t window() const { return shape_.kernel * stretch(); }
  // Numbers of a window in one input row, and between the beginnings of two rows.
  int64_t stretch() const { return shape_.kernel * shape_.channels; }
  int64_t row() const { return (shape_.size + 2 * shape_.padding) * shape_.channels; }
  int64_t map_floats() const { return row() * (shape_.size + 2 * shape_.padding); }
  // Where panels for Forward, [outputs / 64][window][64], have the weight of place k in a window.
  int64_t PanelIndex(int64_t out, int64_t k) const {
    constexpr int kColumns = DirectKernels::kColumns;
    return (out / kColumns * window() + k) * kColumns + out % kColumns;
  }
  // Calls each(index in the weight, out, place in a window) for all weights, panels in order.
  template <typename Each>
  void ForWeights(const Each& each) const;
  // Maps that are computed at once.
  int64_t chunk_maps() const;

  // Maps with their border of zeros, in `padded` unless they have none.
  const float* Padded(int64_t maps, const float* input, float* padded) const;
  // Where the windows of all output pixels of `maps` maps begin.
  template <typename Float>
  std::vector<Float*> Windows(int64_t maps, Float* map) const;
  void AddInputGradient(int64_t maps, const float* output_gradient, const float* panels, float* gradient) const;
  void AddBiasGradient(int64_t count, const float* output_gradient, std::vector<double>* sums) const;
  // `sums`: [outputs / 64][window][64].
  void AddWeightGradient(int64_t maps, const float* output_gradient, const float* map, bool adds, float* sums) const;

  DirectShape shape_;
  const DirectKernels& kernels_;
};

}  // namespace craftfleet
