#include "common/agent/nets/fft_conv.h"

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <torch/csrc/autograd/custom_function.h>

#include "common/agent/nets/fft_convolution/fft_convolution.h"
#include "common/agent/nets/map_tensors.h"

namespace craftfleet {
namespace {

constexpr int64_t kChannels = FftConvolution::kChannels;
constexpr int64_t kKernel = FftConvolution::kKernel;

FftConvolution ConvolutionOf(int64_t size) { return FftConvolution(static_cast<int>(size)); }

// The output's pixels; the mask goes to `mask` and, where it is defined, what a backward pass needs to `spectra`.
at::Tensor Compute(const at::Tensor& pixels, const at::Tensor& bias, const PreparedWeight& filters,
                   const at::Tensor& mask, const at::Tensor& spectra) {
  at::Tensor output = PooledTensor(pixels.sizes());
  ConvolutionOf(pixels.size(1))
      .Forward(pixels.size(0), DataOf(pixels), DataOf(filters.for_output), DataOf(bias), DataOf(output),
               mask.data_ptr<uint8_t>(), DataOf(spectra));
  return output;
}

at::Tensor MaskFor(const at::Tensor& pixels) {
  return at::empty({ConvolutionOf(pixels.size(1)).mask_bytes(pixels.size(0))}, at::kByte);
}

struct FftConvFunction : torch::autograd::Function<FftConvFunction> {
  // `weight` is what the filters were made of, so that its gradient goes there.
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& input,
                            const at::Tensor& /*weight*/, const at::Tensor& bias, const at::Tensor& for_output,
                            const at::Tensor& for_input_gradient) {
    const at::Tensor pixels = PixelsOf(input);
    const at::Tensor mask = MaskFor(pixels);
    const at::Tensor spectra = PooledTensor({ConvolutionOf(pixels.size(1)).spectra_floats(pixels.size(0))});
    context->save_for_backward({mask, spectra, for_input_gradient});
    context->saved_data["wants_input"] = input.requires_grad();
    return MapOf(Compute(pixels, bias, {for_output, for_input_gradient}, mask, spectra));
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 torch::autograd::variable_list output_gradients) {
    const torch::autograd::variable_list saved = context->get_saved_variables();
    const at::Tensor by_output = PixelsOf(output_gradients[0]);
    const bool wants_input = context->saved_data["wants_input"].toBool();
    const at::Tensor by_input = wants_input ? PooledTensor(by_output.sizes()) : at::Tensor();
    const at::Tensor by_weight = at::empty({kChannels, kChannels, kKernel, kKernel});
    const at::Tensor by_bias = at::empty({kChannels});
    ConvolutionOf(by_output.size(1))
        .Backward(by_output.size(0), DataOf(by_output), saved[0].data_ptr<uint8_t>(), DataOf(saved[1]),
                  DataOf(saved[2]), {DataOf(by_input), DataOf(by_weight), DataOf(by_bias)});
    return {wants_input ? MapOf(by_input) : at::Tensor(), by_weight, by_bias, at::Tensor(), at::Tensor()};
  }
};

}  // namespace

PreparedWeight AllocateFftFilters(int64_t size, bool for_gradients) {
  const int64_t floats = ConvolutionOf(size).filter_floats();
  return {PooledTensor({floats}), for_gradients ? PooledTensor({floats}) : at::Tensor()};
}

void FillFftFilters(int64_t size, const at::Tensor& weight, const PreparedWeight& filters) {
  const FftConvolution convolution = ConvolutionOf(size);
  const at::Tensor values = weight.contiguous();
  convolution.TransformFilter(DataOf(values), FftConvolution::Use::kOutput, DataOf(filters.for_output));
  if (!filters.for_input_gradient.defined()) return;
  convolution.TransformFilter(DataOf(values), FftConvolution::Use::kInputGradient, DataOf(filters.for_input_gradient));
}

at::Tensor FftConvRelu(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias,
                       const PreparedWeight& filters) {
  if (c10::GradMode::is_enabled() && (weight.requires_grad() || input.requires_grad())) {
    return FftConvFunction::apply(input, weight, bias, filters.for_output, filters.for_input_gradient);
  }
  const at::Tensor pixels = PixelsOf(input);
  return MapOf(Compute(pixels, bias, filters, MaskFor(pixels), at::Tensor()));
}

}  // namespace craftfleet
