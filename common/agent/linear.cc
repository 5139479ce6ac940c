#include "common/agent/linear.h"

#include <cstdint>
#include <new>

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "common/base/find_symbol.h"

namespace craftfleet {
namespace {

// dnnl_sgemm of oneDNN's C API, whose header is not among LibTorch's. Row-major C = alpha * op(A) * op(B) + beta * C.
using Sgemm = int(char transpose_a, char transpose_b, int64_t m, int64_t n, int64_t k, float alpha, const float* a,
                  int64_t lda, const float* b, int64_t ldb, float beta, float* c, int64_t ldc);

// Null where libdnnl is not a library of its own.
Sgemm* OneDnnSgemm() {
  static Sgemm* const sgemm = FindSymbol<Sgemm>("dnnl_sgemm");
  return sgemm;
}

}  // namespace

void MultiplyInto(Form form_a, const at::Tensor& a, Form form_b, const at::Tensor& b, float beta, at::Tensor* c) {
  const auto letter = [](Form form) { return form == Form::kTransposed ? 'T' : 'N'; };
  const int64_t inner = form_a == Form::kTransposed ? a.size(0) : a.size(1);
  if (Sgemm* const sgemm = OneDnnSgemm(); sgemm != nullptr) {
    const int status = sgemm(letter(form_a), letter(form_b), c->size(0), c->size(1), inner, 1.0F, a.data_ptr<float>(),
                             a.size(1), b.data_ptr<float>(), b.size(1), beta, c->data_ptr<float>(), c->size(1));
    if (status != 0) throw std::bad_alloc();  // the only failure of valid arguments
    return;
  }
  const auto op = [](Form form, const at::Tensor& x) { return form == Form::kTransposed ? x.t() : x; };
  at::addmm_out(*c, *c, op(form_a, a), op(form_b, b), beta, 1.0F);
}

at::Tensor LinearOutput(const at::Tensor& rows, const at::Tensor& weight, const at::Tensor& bias) {
  const int64_t shape[] = {rows.size(0), weight.size(0)};
  at::Tensor output = bias.defined() ? bias.expand(shape).clone(at::MemoryFormat::Contiguous) : at::empty(shape);
  MultiplyInto(Form::kPlain, rows, Form::kTransposed, weight, bias.defined() ? 1.0F : 0.0F, &output);
  return output;
}

namespace {

struct LinearFunction : torch::autograd::Function<LinearFunction> {
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& input,
                            const at::Tensor& weight, const c10::optional<at::Tensor>& bias) {
    const at::Tensor rows = input.contiguous();
    context->save_for_backward({rows, weight});
    context->saved_data["has_bias"] = bias.has_value();
    return LinearOutput(rows, weight, bias.value_or(at::Tensor()));
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 torch::autograd::variable_list output_gradients) {
    const torch::autograd::variable_list saved = context->get_saved_variables();
    const at::Tensor& input = saved[0];
    const at::Tensor& weight = saved[1];
    const at::Tensor gradient = output_gradients[0].contiguous();
    at::Tensor input_gradient = at::empty_like(input);
    at::Tensor weight_gradient = at::empty_like(weight);
    MultiplyInto(Form::kPlain, gradient, Form::kPlain, weight, 0.0F, &input_gradient);
    MultiplyInto(Form::kTransposed, gradient, Form::kPlain, input, 0.0F, &weight_gradient);
    const bool has_bias = context->saved_data["has_bias"].toBool();
    return {input_gradient, weight_gradient, has_bias ? gradient.sum(0) : at::Tensor()};
  }
};

}  // namespace

at::Tensor Linear(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
  const c10::optional<at::Tensor> maybe_bias = bias.defined() ? c10::make_optional(bias) : c10::nullopt;
  return input.is_cpu() ? LinearFunction::apply(input, weight, maybe_bias) : at::linear(input, weight, maybe_bias);
}

bool LinearUsesOneDnn() { return OneDnnSgemm() != nullptr; }

}  // namespace craftfleet
