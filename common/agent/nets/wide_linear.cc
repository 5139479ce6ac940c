#include "common/agent/nets/wide_linear.h"

#include <type_traits>
#include <vector>

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "common/agent/linear.h"
#include "common/agent/nets/map_tensors.h"
#include "common/agent/nets/wide_product.h"

namespace craftfleet {
namespace {

template <typename Number>
WideProduct<Number> ProductOf(const at::Tensor& weight) {
  return {weight.size(1), weight.size(0)};
}

template <typename Number>
const Number* NumbersOf(const at::Tensor& tensor) {
  return static_cast<const Number*>(tensor.data_ptr());
}

// float[N,F] as it is multiplied, contiguous.
template <typename Number>
at::Tensor Multiplied(const at::Tensor& rows) {
  if constexpr (std::is_same_v<Number, float>) return rows.contiguous();
  return RoundedTensor(rows.sizes()).copy_(rows);
}

// The output of few rows.
template <typename Number>
at::Tensor LibraryOutput(const at::Tensor& rows, const at::Tensor& multiplied, const at::Tensor& bias) {
  if constexpr (std::is_same_v<Number, float>) return LinearOutput(rows, multiplied, bias);
  return at::linear(rows, multiplied).to(at::kFloat).add_(bias);
}

template <typename Number>
struct WideLinearFunction : torch::autograd::Function<WideLinearFunction<Number>> {
  // `weight` is what `multiplied` was made of, so that its gradient goes there.
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& input,
                            const at::Tensor& /*weight*/, const at::Tensor& multiplied, const at::Tensor& bias,
                            const c10::intrusive_ptr<WideFactors>& factors) {
    const at::Tensor rows = Multiplied<Number>(input);
    context->save_for_backward({rows, multiplied});
    if (factors != nullptr) context->saved_data["factors"] = c10::IValue::make_capsule(factors);
    if (rows.size(0) < WideProduct<Number>::kMinRows) return LibraryOutput<Number>(rows, multiplied, bias);
    at::Tensor output = at::empty({rows.size(0), multiplied.size(0)});
    ProductOf<Number>(multiplied)
        .Forward(rows.size(0), NumbersOf<Number>(rows), NumbersOf<Number>(multiplied), DataOf(output));
    return output.add_(bias);
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 torch::autograd::variable_list output_gradients) {
    const torch::autograd::variable_list saved = context->get_saved_variables();
    const at::Tensor& input = saved[0];
    const at::Tensor& multiplied = saved[1];
    const at::Tensor gradient = Multiplied<Number>(output_gradients[0]);
    const at::Tensor input_gradient = at::empty(input.sizes());
    ProductOf<Number>(multiplied)
        .InputGradient(input.size(0), NumbersOf<Number>(gradient), NumbersOf<Number>(multiplied),
                       DataOf(input_gradient));
    at::Tensor weight_gradient;
    if (const auto found = context->saved_data.find("factors"); found != context->saved_data.end()) {
      const auto factors = c10::static_intrusive_pointer_cast<WideFactors>(found->second.toCapsule());
      factors->output_gradient = gradient;
      factors->input = input;
    } else {
      weight_gradient = at::empty(multiplied.sizes());
      WideFactors own;
      own.output_gradient = gradient;
      own.input = input;
      WideWeightGradient({&own}, 0, multiplied.size(1), {DataOf(weight_gradient)});
    }
    return {input_gradient, weight_gradient, at::Tensor(), output_gradients[0].sum(0), at::Tensor()};
  }
};

template <typename Number>
void SumGradients(absl::Span<const WideFactors* const> shards, int64_t begin, int64_t end,
                  absl::Span<float* const> parts) {
  std::vector<typename WideProduct<Number>::Rows> rows;
  for (const WideFactors* shard : shards) {
    rows.push_back({shard->input.size(0), NumbersOf<Number>(shard->output_gradient), NumbersOf<Number>(shard->input)});
  }
  const WideProduct<Number> product(shards[0]->input.size(1), shards[0]->output_gradient.size(1));
  product.WeightGradient(rows, begin, end, parts);
}

}  // namespace

bool WideLinearFits(const at::Tensor& weight, at::ScalarType type) {
  if (!weight.is_cpu() || weight.dim() != 2 || !weight.is_contiguous()) return false;
  if (type == at::kFloat) return WideProduct<float>::Fits(weight.size(1), weight.size(0));
  return type == at::kBFloat16 && WideProduct<Bfloat16>::Fits(weight.size(1), weight.size(0));
}

at::Tensor WideLinear(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& multiplied,
                      const at::Tensor& bias, const c10::intrusive_ptr<WideFactors>& factors) {
  if (multiplied.scalar_type() == at::kFloat) {
    return WideLinearFunction<float>::apply(input, weight, multiplied.detach(), bias, factors);
  }
  return WideLinearFunction<Bfloat16>::apply(input, weight, multiplied.detach(), bias, factors);
}

void WideWeightGradient(absl::Span<const WideFactors* const> shards, int64_t begin, int64_t end,
                        absl::Span<float* const> parts) {
  if (shards[0]->input.scalar_type() == at::kFloat) {
    SumGradients<float>(shards, begin, end, parts);
  } else {
    SumGradients<Bfloat16>(shards, begin, end, parts);
  }
}

}  // namespace craftfleet
