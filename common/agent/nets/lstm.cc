#include "common/agent/nets/lstm.h"

#include <tuple>

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "common/agent/linear.h"
#include "common/base/multiversion.h"

namespace craftfleet {
namespace {

using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

// c = f * c_before + i * g of one row; `gates` are activated.
CRAFTFLEET_MULTIVERSION
void UpdateCells(int64_t hidden, const float* __restrict gates, const float* __restrict before,
                 float* __restrict cells) {
  const float* const input = gates;
  const float* const forget = gates + hidden;
  const float* const candidate = gates + 2 * hidden;
  for (int64_t i = 0; i < hidden; ++i) cells[i] = forget[i] * before[i] + input[i] * candidate[i];
}

// The saved values of one row's step, and its incoming gradients.
struct StepRow {
  const float* gates;  // [4H] activated
  const float* cells_before;
  const float* tanh_cells;
  const float* by_output;  // from above
  const float* by_hidden;  // from the step after
};

// Writes the gradient by the gates before activation; `by_cells` comes from the next step and becomes that of the
// previous one.
CRAFTFLEET_MULTIVERSION
void BackwardRow(int64_t hidden, StepRow row, float* __restrict by_cells, float* __restrict by_gates) {
  for (int64_t j = 0; j < hidden; ++j) {
    const float i = row.gates[j];
    const float f = row.gates[hidden + j];
    const float g = row.gates[2 * hidden + j];
    const float o = row.gates[3 * hidden + j];
    const float tanh_cell = row.tanh_cells[j];
    const float by_h = row.by_output[j] + row.by_hidden[j];
    const float by_c = by_cells[j] + by_h * o * (1 - tanh_cell * tanh_cell);
    by_gates[j] = by_c * g * i * (1 - i);
    by_gates[hidden + j] = by_c * row.cells_before[j] * f * (1 - f);
    by_gates[2 * hidden + j] = by_c * i * (1 - g * g);
    by_gates[3 * hidden + j] = by_h * tanh_cell * o * (1 - o);
    by_cells[j] = by_c * f;
  }
}

// i, f, g and o of rows float[n,4H], in place.
void Activate(const at::Tensor& gates, int64_t hidden) {
  gates.narrow(1, 0, 2 * hidden).sigmoid_();
  gates.narrow(1, 2 * hidden, hidden).tanh_();
  gates.narrow(1, 3 * hidden, hidden).sigmoid_();
}

struct LstmFunction : torch::autograd::Function<LstmFunction> {
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static variable_list forward(AutogradContext* context, const at::Tensor& input, const at::Tensor& states,
                               const at::Tensor& input_weight, const at::Tensor& hidden_weight,
                               const at::Tensor& input_bias, const at::Tensor& hidden_bias,
                               const std::vector<int64_t>& batch_sizes) {
    const int64_t hidden = hidden_weight.size(1);
    const at::Tensor rows = input.contiguous();
    const int64_t n = rows.size(0);
    at::Tensor gates = (input_bias + hidden_bias).expand({n, 4 * hidden}).clone(at::MemoryFormat::Contiguous);
    MultiplyInto(Form::kPlain, rows, Form::kTransposed, input_weight, 1.0F, &gates);

    const at::Tensor hidden_before = at::empty({n, hidden});
    const at::Tensor cells_before = at::empty({n, hidden});
    at::Tensor tanh_cells = at::empty({n, hidden});
    at::Tensor outputs = at::empty({n, hidden});
    // The current state of each segment.
    const at::Tensor h = states.narrow(1, 0, hidden).clone(at::MemoryFormat::Contiguous);
    const at::Tensor c = states.narrow(1, hidden, hidden).clone(at::MemoryFormat::Contiguous);
    int64_t first = 0;
    for (const int64_t count : batch_sizes) {
      const at::Tensor h_now = h.narrow(0, 0, count);
      const at::Tensor c_now = c.narrow(0, 0, count);
      hidden_before.narrow(0, first, count).copy_(h_now);
      cells_before.narrow(0, first, count).copy_(c_now);
      at::Tensor step = gates.narrow(0, first, count);
      MultiplyInto(Form::kPlain, h_now, Form::kTransposed, hidden_weight, 1.0F, &step);
      Activate(step, hidden);
      for (int64_t row = 0; row < count; ++row) {
        UpdateCells(hidden, step.data_ptr<float>() + row * 4 * hidden,
                    cells_before.data_ptr<float>() + (first + row) * hidden, c.data_ptr<float>() + row * hidden);
      }
      at::Tensor tanh_now = tanh_cells.narrow(0, first, count);
      at::tanh_out(tanh_now, c_now);
      at::Tensor output = outputs.narrow(0, first, count);
      at::mul_out(output, step.narrow(1, 3 * hidden, hidden), tanh_now);
      h_now.copy_(output);
      first += count;
    }
    context->save_for_backward({rows, input_weight, hidden_weight, gates, hidden_before, cells_before, tanh_cells});
    context->saved_data["batch_sizes"] = batch_sizes;
    const at::Tensor last_states = at::cat({h, c}, 1);
    context->mark_non_differentiable({last_states});
    return {outputs, last_states};
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static variable_list backward(AutogradContext* context, variable_list output_gradients) {
    const variable_list saved = context->get_saved_variables();
    const at::Tensor& rows = saved[0];
    const at::Tensor& input_weight = saved[1];
    const at::Tensor& hidden_weight = saved[2];
    const at::Tensor& hidden_before = saved[4];
    const at::Tensor by_gates = BackwardSteps(context->saved_data["batch_sizes"].toIntVector(), hidden_weight, saved[3],
                                              saved[5], saved[6], output_gradients[0].contiguous());
    at::Tensor by_input = at::empty_like(rows);
    at::Tensor by_input_weight = at::empty_like(input_weight);
    at::Tensor by_hidden_weight = at::empty_like(hidden_weight);
    MultiplyInto(Form::kPlain, by_gates, Form::kPlain, input_weight, 0.0F, &by_input);
    MultiplyInto(Form::kTransposed, by_gates, Form::kPlain, rows, 0.0F, &by_input_weight);
    MultiplyInto(Form::kTransposed, by_gates, Form::kPlain, hidden_before, 0.0F, &by_hidden_weight);
    const at::Tensor by_bias = by_gates.sum(0);
    return {by_input, at::Tensor(), by_input_weight, by_hidden_weight, by_bias, by_bias.clone(), at::Tensor()};
  }

 private:
  // The gradient by the gates before activation, float[N,4H], step after step from the last.
  static at::Tensor BackwardSteps(const std::vector<int64_t>& batch_sizes, const at::Tensor& hidden_weight,
                                  const at::Tensor& gates, const at::Tensor& cells_before, const at::Tensor& tanh_cells,
                                  const at::Tensor& by_outputs) {
    const int64_t hidden = hidden_weight.size(1);
    at::Tensor by_gates = at::empty_like(gates);
    const at::Tensor by_hidden = at::zeros({batch_sizes.front(), hidden});
    const at::Tensor by_cells = at::zeros({batch_sizes.front(), hidden});
    int64_t first = gates.size(0);
    for (auto count = batch_sizes.rbegin(); count != batch_sizes.rend(); ++count) {
      first -= *count;
      for (int64_t row = 0; row < *count; ++row) {
        const int64_t at = (first + row) * hidden;
        BackwardRow(
            hidden,
            {gates.data_ptr<float>() + 4 * at, cells_before.data_ptr<float>() + at, tanh_cells.data_ptr<float>() + at,
             by_outputs.data_ptr<float>() + at, by_hidden.data_ptr<float>() + row * hidden},
            by_cells.data_ptr<float>() + row * hidden, by_gates.data_ptr<float>() + 4 * at);
      }
      at::Tensor before = by_hidden.narrow(0, 0, *count);
      if (first > 0) {
        MultiplyInto(Form::kPlain, by_gates.narrow(0, first, *count), Form::kPlain, hidden_weight, 0.0F, &before);
      }
    }
    return by_gates;
  }
};

// On a device, with LibTorch's fused cell. cuDNN, which at::lstm takes, wants the weights in a memory of their own and
// warns at each call where they are views of a larger one. One product before the steps and one after for each weight;
// a step is two computations, forward and backward.
struct DeviceLstmFunction : torch::autograd::Function<DeviceLstmFunction> {
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static variable_list forward(AutogradContext* context, const at::Tensor& input, const at::Tensor& states,
                               const at::Tensor& input_weight, const at::Tensor& hidden_weight,
                               const at::Tensor& input_bias, const at::Tensor& hidden_bias,
                               const std::vector<int64_t>& batch_sizes) {
    const int64_t hidden = hidden_weight.size(1);
    const at::Tensor gates = at::addmm(input_bias + hidden_bias, input, input_weight.t());
    at::Tensor h = states.narrow(1, 0, hidden);
    at::Tensor c = states.narrow(1, hidden, hidden).contiguous();
    std::vector<at::Tensor> outputs, hidden_before;
    std::vector<at::Tensor> ended;  // states of segments, the shortest first
    variable_list saved = {input, input_weight, hidden_weight, at::Tensor()};
    int64_t first = 0;
    const auto end_segments = [&](int64_t left) {
      const int64_t count = h.size(0) - left;
      if (count > 0) ended.insert(ended.begin(), at::cat({h.narrow(0, left, count), c.narrow(0, left, count)}, 1));
      h = h.narrow(0, 0, left);
      c = c.narrow(0, 0, left);
    };
    for (const int64_t count : batch_sizes) {
      end_segments(count);
      hidden_before.push_back(h);
      const at::Tensor by_hidden = at::mm(h, hidden_weight.t());
      const auto [next_h, next_c, workspace] = at::_thnn_fused_lstm_cell(gates.narrow(0, first, count), by_hidden, c);
      saved.insert(saved.end(), {c, next_c, workspace});
      outputs.push_back(next_h);
      h = next_h;
      c = next_c;
      first += count;
    }
    end_segments(0);
    saved[3] = at::cat(hidden_before);
    context->save_for_backward(saved);
    context->saved_data["batch_sizes"] = batch_sizes;
    const at::Tensor last_states = at::cat(ended);
    context->mark_non_differentiable({last_states});
    return {at::cat(outputs), last_states};
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static variable_list backward(AutogradContext* context, variable_list output_gradients) {
    const variable_list saved = context->get_saved_variables();
    const at::Tensor& input_weight = saved[1];
    const at::Tensor& hidden_weight = saved[2];
    const std::vector<int64_t> batch_sizes = context->saved_data["batch_sizes"].toIntVector();
    // Gets the gradients from the next steps.
    const at::Tensor by_outputs = output_gradients[0].clone(at::MemoryFormat::Contiguous);
    std::vector<at::Tensor> parts(batch_sizes.size());
    at::Tensor by_cells;
    int64_t first = by_outputs.size(0);
    for (size_t step = batch_sizes.size(); step-- > 0;) {
      const int64_t count = batch_sizes[step];
      first -= count;
      at::Tensor by_hidden = by_outputs.narrow(0, first, count);
      if (by_cells.defined()) {
        const int64_t next = by_cells.size(0);
        by_hidden.narrow(0, 0, next).addmm_(parts[step + 1], hidden_weight);
        if (next < count) by_cells = at::constant_pad_nd(by_cells, {0, 0, 0, count - next});
      }
      const variable_list of_step(saved.begin() + 4 + 3 * step, saved.begin() + 7 + 3 * step);
      std::tie(parts[step], by_cells, std::ignore) = at::_thnn_fused_lstm_cell_backward_impl(
          by_hidden, by_cells, of_step[0], of_step[1], of_step[2], /*has_bias=*/false);
    }
    const at::Tensor by_gates = at::cat(parts);
    const at::Tensor by_bias = by_gates.sum(0);
    return {by_gates.mm(input_weight), at::Tensor(), by_gates.t().mm(saved[0]), by_gates.t().mm(saved[3]), by_bias,
            by_bias.clone(),           at::Tensor()};
  }
};

}  // namespace

LstmOutput Lstm(const at::Tensor& input, const std::vector<int64_t>& batch_sizes, const at::Tensor& states,
                const LstmWeights& weights) {
  const auto run = [&](auto function) {
    return decltype(function)::apply(input, states, weights.input, weights.hidden, weights.input_bias,
                                     weights.hidden_bias, batch_sizes);
  };
  const variable_list result = input.is_cpu() ? run(LstmFunction()) : run(DeviceLstmFunction());
  return {result[0], result[1]};
}

}  // namespace craftfleet
