#include "common/agent/nets/direct_conv.h"

#include <cstdint>
#include <vector>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <torch/csrc/autograd/custom_function.h>

#include "common/agent/nets/map_tensors.h"
#include "common/base/check.h"

namespace craftfleet {
namespace {

uint8_t* BitsOf(const at::Tensor& mask) { return mask.defined() ? mask.data_ptr<uint8_t>() : nullptr; }

at::Tensor Compute(const DirectShape& shape, const at::Tensor& pixels, const at::Tensor& bias, const at::Tensor& panels,
                   const at::Tensor& mask) {
  const int64_t size = shape.output_size();
  at::Tensor output = PooledTensor({pixels.size(0), size, size, shape.outputs});
  DirectConvolution(shape).Forward(pixels.size(0), DataOf(pixels), DataOf(panels), DataOf(bias), DataOf(output),
                                   BitsOf(mask));
  return output;
}

at::Tensor MaskFor(const DirectShape& shape, int64_t n, Activation activation) {
  if (activation == Activation::kNone) return {};
  return at::empty({DirectConvolution(shape).mask_bytes(n)}, at::kByte);
}

// As what autograd keeps, and back.
std::vector<int64_t> NumbersOf(const DirectShape& shape) {
  return {shape.channels, shape.outputs, shape.kernel, shape.stride, shape.padding, shape.size};
}
DirectShape ShapeOf(const std::vector<int64_t>& numbers) {
  return {numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5]};
}

struct DirectConvFunction : torch::autograd::Function<DirectConvFunction> {
  // `weight` is what the panels were made of, so that its gradient goes there.
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& input,
                            const at::Tensor& /*weight*/, const at::Tensor& bias, const at::Tensor& for_output,
                            const c10::optional<at::Tensor>& for_input_gradient, const std::vector<int64_t>& numbers,
                            bool has_relu) {
    const DirectShape shape = ShapeOf(numbers);
    const at::Tensor pixels = PixelsOf(input);
    const at::Tensor mask = MaskFor(shape, pixels.size(0), has_relu ? Activation::kRelu : Activation::kNone);
    context->save_for_backward({pixels, mask, for_input_gradient.value_or(at::Tensor())});
    context->saved_data["shape"] = numbers;
    context->saved_data["wants_input"] = input.requires_grad();
    return MapOf(Compute(shape, pixels, bias, for_output, mask));
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 torch::autograd::variable_list output_gradients) {
    const torch::autograd::variable_list saved = context->get_saved_variables();
    const DirectShape shape = ShapeOf(context->saved_data["shape"].toIntVector());
    const at::Tensor by_output = PixelsOf(output_gradients[0]);
    const bool wants_input = context->saved_data["wants_input"].toBool();
    const at::Tensor by_input = wants_input ? PooledTensor(saved[0].sizes()) : at::Tensor();
    const at::Tensor by_weight = at::empty({shape.outputs, shape.channels, shape.kernel, shape.kernel});
    const at::Tensor by_bias = at::empty({shape.outputs});
    DirectConvolution(shape).Backward(by_output.size(0), DataOf(by_output), BitsOf(saved[1]), DataOf(saved[0]),
                                      DataOf(saved[2]), {DataOf(by_input), DataOf(by_weight), DataOf(by_bias)});
    return {wants_input ? MapOf(by_input) : at::Tensor(),
            by_weight,
            by_bias,
            at::Tensor(),
            at::Tensor(),
            at::Tensor(),
            at::Tensor()};
  }
};

}  // namespace

PreparedWeight AllocateDirectPanels(const DirectShape& shape, bool wants_input_gradient) {
  const int64_t floats = DirectConvolution(shape).weight_floats();
  return {PooledTensor({floats}), wants_input_gradient ? PooledTensor({floats}) : at::Tensor()};
}

void FillDirectPanels(const DirectShape& shape, const at::Tensor& weight, const PreparedWeight& panels) {
  const DirectConvolution convolution(shape);
  const at::Tensor values = weight.contiguous();
  convolution.ArrangeWeight(DataOf(values), DirectConvolution::Use::kOutput, DataOf(panels.for_output));
  if (!panels.for_input_gradient.defined()) return;
  convolution.ArrangeWeight(DataOf(values), DirectConvolution::Use::kInputGradient, DataOf(panels.for_input_gradient));
}

at::Tensor DirectConv(const DirectShape& shape, const at::Tensor& input, const at::Tensor& weight,
                      const at::Tensor& bias, Activation activation, const PreparedWeight& panels) {
  if (c10::GradMode::is_enabled() && (weight.requires_grad() || input.requires_grad())) {
    const at::Tensor& for_input = panels.for_input_gradient;
    CRAFTFLEET_CHECK(for_input.defined() || !input.requires_grad());
    return DirectConvFunction::apply(input, weight, bias, panels.for_output,
                                     for_input.defined() ? c10::make_optional(for_input) : c10::nullopt,
                                     NumbersOf(shape), activation == Activation::kRelu);
  }
  const at::Tensor pixels = PixelsOf(input);
  return MapOf(Compute(shape, pixels, bias, panels.for_output, MaskFor(shape, pixels.size(0), activation)));
}

}  // namespace craftfleet
