#include "common/agent/nets/recurrent_core.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>
#include <vector>

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "common/agent/nets/lstm.h"
#include "common/agent/nets/param_tensors.h"
#include "common/agent/nets/segments.h"
#include "common/base/check.h"

namespace craftfleet {
namespace {

// Places as an index tensor, int64[n].
at::Tensor IndexTensor(const std::vector<int64_t>& places) { return at::tensor(places, at::kLong); }

// The place of each number in `order`, a permutation.
std::vector<int64_t> Inverse(const std::vector<int64_t>& order) {
  std::vector<int64_t> inverse(order.size());
  for (size_t i = 0; i < order.size(); ++i) inverse[order[i]] = static_cast<int64_t>(i);
  return inverse;
}

// Rows in another order. Autograd would add the gradients of index_select row by row, on a GPU after sorting them.
struct PermuteFunction : torch::autograd::Function<PermuteFunction> {
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& rows, const at::Tensor& order,
                            const at::Tensor& inverse) {
    context->saved_data["inverse"] = inverse;
    return rows.index_select(0, order);
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& output_gradients) {
    return {output_gradients[0].index_select(0, context->saved_data["inverse"].toTensor()), {}, {}};
  }
};

ParamInit LstmInit() { return {ParamInit::Kind::kUniform, 1 / std::sqrt(static_cast<double>(LstmLayer::kHidden))}; }

}  // namespace

Packing Pack(const std::vector<int>& lengths) {
  std::vector<int64_t> first_rows(lengths.size());
  std::exclusive_scan(lengths.begin(), lengths.end(), first_rows.begin(), int64_t{0});
  std::vector<int64_t> by_length(lengths.size());
  std::iota(by_length.begin(), by_length.end(), 0);
  std::stable_sort(by_length.begin(), by_length.end(), [&](int64_t a, int64_t b) { return lengths[a] > lengths[b]; });

  std::vector<int64_t> packed;
  std::vector<int64_t> batch_sizes;
  for (int step = 0; !lengths.empty() && step < lengths[by_length[0]]; ++step) {
    const size_t before = packed.size();
    for (const int64_t segment : by_length) {
      if (step >= lengths[segment]) break;
      packed.push_back(first_rows[segment] + step);
    }
    batch_sizes.push_back(static_cast<int64_t>(packed.size() - before));
  }
  return {IndexTensor(packed), IndexTensor(Inverse(packed)), IndexTensor(by_length), IndexTensor(Inverse(by_length)),
          batch_sizes};
}

LstmLayer::LstmLayer(const std::string& name, int64_t inputs, ParamList* params)
    : weight_ih_(params->Add(name + ".weight_ih_l0", {4 * kHidden, inputs}, LstmInit())),
      weight_hh_(params->Add(name + ".weight_hh_l0", {4 * kHidden, kHidden}, LstmInit())),
      bias_ih_(params->Add(name + ".bias_ih_l0", {4 * kHidden}, LstmInit())),
      bias_hh_(params->Add(name + ".bias_hh_l0", {4 * kHidden}, LstmInit())) {}

at::Tensor LstmLayer::Forward(const ParamTensors& params, const at::Tensor& features, const Packing& packing,
                              const at::Tensor& states, at::Tensor* last_states) const {
  const LstmOutput result = Lstm(PermuteFunction::apply(features, packing.rows, packing.inverse_rows),
                                 packing.batch_sizes, states.index_select(0, packing.segments),
                                 {params[weight_ih_], params[weight_hh_], params[bias_ih_], params[bias_hh_]});
  *last_states = result.last_states.index_select(0, packing.inverse_segments);
  return PermuteFunction::apply(result.outputs, packing.inverse_rows, packing.rows);
}

RecurrentCore::RecurrentCore(int64_t inputs, Critic critic, ParamList* params)
    : lstm_actor_("lstm_actor", inputs, params) {
  if (critic == Critic::kLstm) {
    lstm_critic_.emplace("lstm_critic", inputs, params);
  } else {
    const ParamInit init = {ParamInit::Kind::kUniform, 1 / std::sqrt(static_cast<double>(inputs))};
    critic_.emplace("critic", inputs, LstmLayer::kHidden, init, Bias::kLikeWeight, params);
  }
}

void RecurrentCore::Forward(const ParamTensors& params, const at::Tensor& features, const Segments& segments,
                            at::Tensor* actor_features, at::Tensor* critic_features, at::Tensor* last_states) const {
  CRAFTFLEET_CHECK(std::accumulate(segments.lengths.begin(), segments.lengths.end(), int64_t{0}) == features.size(0));
  CRAFTFLEET_CHECK(segments.states.size(0) == static_cast<int64_t>(segments.lengths.size()));
  CRAFTFLEET_CHECK(segments.states.size(1) == state_size());
  const Packing packing = segments.packing.has_value() ? *segments.packing : Pack(segments.lengths);
  constexpr int64_t kOne = LstmLayer::kStateSize;
  *actor_features = lstm_actor_.Forward(params, features, packing, segments.states.narrow(1, 0, kOne), last_states);
  if (!lstm_critic_.has_value()) {
    *critic_features = critic_->Forward(params, features);
    return;
  }
  at::Tensor critic_states;
  *critic_features =
      lstm_critic_->Forward(params, features, packing, segments.states.narrow(1, kOne, kOne), &critic_states);
  *last_states = at::cat({*last_states, critic_states}, 1);
}

}  // namespace craftfleet
