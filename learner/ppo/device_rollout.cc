#include "learner/ppo/device_rollout.h"

#include <algorithm>
#include <cstdint>
#include <utility>

#include <ATen/ATen.h>

namespace craftfleet {
namespace {

at::Tensor Send(const at::Tensor& host, at::Device device) { return host.to(device, /*non_blocking=*/true); }

// `values` and `padding` behind them.
template <typename Out, typename In>
at::Tensor SendPadded(const std::vector<In>& values, at::ScalarType type, at::Device device, Out padding = 0) {
  const at::Tensor host = HostTensor({static_cast<int64_t>(values.size()) + 1}, type, device);
  auto* out = host.data_ptr<Out>();
  for (const In& value : values) *out++ = static_cast<Out>(value);
  *out = padding;
  return Send(host, device);
}

at::Tensor SendFrames(const Rollout& rollout, const AgentSpec& spec, at::Device device) {
  const auto rows = static_cast<int64_t>(rollout.size());
  const at::Tensor host = HostTensor({rows + 1, spec.frame_size, spec.frame_size, 3}, at::kByte, device);
  auto* out = host.data_ptr<uint8_t>();
  for (const uint8_t* frame : rollout.frames) out = std::copy_n(frame, spec.frame_bytes(), out);
  std::fill_n(out, spec.frame_bytes(), uint8_t{0});
  return Send(host, device);
}

at::Tensor SendStates(const Rollout& rollout, int state_size, at::Device device) {
  const auto& states = rollout.states;
  const auto kept = std::count_if(states.begin(), states.end(), [](const float* state) { return state != nullptr; });
  const at::Tensor host = HostTensor({kept + 1, state_size}, at::kFloat, device);
  auto* out = host.data_ptr<float>();
  for (const float* state : states) {
    if (state != nullptr) out = std::copy_n(state, state_size, out);
  }
  std::fill_n(out, state_size, 0.0F);
  return Send(host, device);
}

// The place of each row's state in DeviceRollout::states.
std::vector<int64_t> StatePlaces(const Rollout& rollout) {
  std::vector<int64_t> places;
  int64_t kept = 0;
  for (const float* state : rollout.states) places.push_back(state != nullptr ? kept++ : -1);
  for (int64_t& place : places) {
    if (place < 0) place = kept;
  }
  return places;
}

// Index tensors, sent together.
class Indices {
 public:
  // Returns what Get takes.
  std::pair<int64_t, int64_t> Add(const std::vector<int64_t>& places) {
    const auto first = static_cast<int64_t>(all_.size());
    all_.insert(all_.end(), places.begin(), places.end());
    return {first, static_cast<int64_t>(places.size())};
  }
  std::pair<int64_t, int64_t> Add(const at::Tensor& places) {
    const auto* const data = places.data_ptr<int64_t>();
    return Add(std::vector<int64_t>(data, data + places.numel()));
  }

  void SendTo(at::Device device) {
    const at::Tensor host = HostTensor({static_cast<int64_t>(all_.size())}, at::kLong, device);
    std::copy(all_.begin(), all_.end(), host.data_ptr<int64_t>());
    there_ = Send(host, device);
  }

  at::Tensor Get(std::pair<int64_t, int64_t> part) const { return there_.narrow(0, part.first, part.second); }

 private:
  std::vector<int64_t> all_;
  at::Tensor there_;
};

std::vector<int64_t> RowsOf(const Minibatch& minibatch, const Rollout& rollout) {
  const auto padding = static_cast<int64_t>(rollout.size());
  std::vector<int64_t> rows;
  for (const int row : minibatch.rows) rows.push_back(row == kPadding ? padding : row);
  return rows;
}

constexpr size_t kRecurrentRows = 32;  // recurrent agents' frames are a multiple of it

std::vector<int64_t> FirstStatesOf(const Minibatch& minibatch, const std::vector<int64_t>& places) {
  std::vector<int64_t> first_states;
  size_t first = 0;
  for (const int length : minibatch.lengths) {
    first_states.push_back(places[minibatch.rows[first]]);
    first += length;
  }
  return first_states;
}

}  // namespace

at::Tensor HostTensor(at::IntArrayRef shape, at::ScalarType type, at::Device device) {
  return at::empty(shape, at::TensorOptions(type).pinned_memory(device.is_cuda()));
}

DeviceRollout SendRollout(const Rollout& rollout, const AgentSpec& spec, at::Device device) {
  DeviceRollout there;
  there.frames = SendFrames(rollout, spec, device);
  there.actions = SendPadded<int64_t>(rollout.actions, at::kLong, device);
  SendTargets(rollout, device, &there);
  if (spec.state_size > 0) there.states = SendStates(rollout, spec.state_size, device);
  return there;
}

void SendTargets(const Rollout& rollout, at::Device device, DeviceRollout* there) {
  there->log_probs = SendPadded<float>(rollout.log_probs, at::kFloat, device);
  there->advantages = SendPadded<float>(rollout.advantages, at::kFloat, device);
  there->returns = SendPadded<float>(rollout.returns, at::kFloat, device);
  if (!rollout.weights.empty()) there->weights = SendPadded(rollout.weights, at::kFloat, device, 1.0F);
}

std::vector<DeviceMinibatch> SendMinibatches(const std::vector<Minibatch>& minibatches, const Rollout& rollout,
                                             at::Device device) {
  struct Parts {
    std::pair<int64_t, int64_t> rows, first_states, packed_rows, inverse_rows, segments, inverse_segments;
  };
  const std::vector<int64_t> places = StatePlaces(rollout);
  Indices indices;
  std::vector<Parts> all;
  std::vector<DeviceMinibatch> there;
  for (const Minibatch& minibatch : minibatches) {
    Parts parts;
    std::vector<int64_t> rows = RowsOf(minibatch, rollout);
    if (!minibatch.lengths.empty()) {
      rows.resize((rows.size() + kRecurrentRows - 1) / kRecurrentRows * kRecurrentRows,
                  static_cast<int64_t>(rollout.size()));
    }
    parts.rows = indices.Add(rows);
    DeviceMinibatch& sent = there.emplace_back();
    if (minibatch.lengths.empty() && !rollout.states.empty()) {  // a memory before each row
      parts.first_states =
          indices.Add(FirstStatesOf({minibatch.rows, std::vector<int>(minibatch.rows.size(), 1)}, places));
    } else if (!minibatch.lengths.empty()) {
      sent.segments.lengths = minibatch.lengths;
      sent.segments.packing = Pack(minibatch.lengths);
      parts.first_states = indices.Add(FirstStatesOf(minibatch, places));
      parts.packed_rows = indices.Add(sent.segments.packing->rows);
      parts.inverse_rows = indices.Add(sent.segments.packing->inverse_rows);
      parts.segments = indices.Add(sent.segments.packing->segments);
      parts.inverse_segments = indices.Add(sent.segments.packing->inverse_segments);
    }
    all.push_back(parts);
  }
  indices.SendTo(device);
  for (size_t i = 0; i < there.size(); ++i) {
    there[i].frame_rows = indices.Get(all[i].rows);
    there[i].rows = there[i].frame_rows.narrow(0, 0, static_cast<int64_t>(minibatches[i].rows.size()));
    there[i].first_states = indices.Get(all[i].first_states);
    if (!there[i].segments.packing.has_value()) continue;
    Packing& packing = *there[i].segments.packing;
    packing.rows = indices.Get(all[i].packed_rows);
    packing.inverse_rows = indices.Get(all[i].inverse_rows);
    packing.segments = indices.Get(all[i].segments);
    packing.inverse_segments = indices.Get(all[i].inverse_segments);
  }
  return there;
}

}  // namespace craftfleet
