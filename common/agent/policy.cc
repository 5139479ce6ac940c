#include "common/agent/policy.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <optional>
#include <utility>

#include <ATen/ATen.h>
#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <c10/core/InferenceMode.h>
#include <c10/core/Stream.h>
#include <c10/core/StreamGuard.h>

#include "common/agent/aligned_weights.h"
#include "common/agent/categorical.h"
#include "common/agent/code_change.h"
#include "common/agent/device.h"
#include "common/agent/device_snapshot.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/base/check.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// The input in each row of each tile.
using TileRows = std::vector<std::vector<int>>;
constexpr int kNoInput = -1;
constexpr char kCpuDevice[] = "cpu";

// Assigns each input to the first tile whose row is free.
TileRows DealRows(absl::Span<const int> lanes, int tile) {
  TileRows tiles;
  std::vector<size_t> used(tile, 0);  // tiles in which the row is taken
  for (size_t i = 0; i < lanes.size(); ++i) {
    const int row = lanes[i] % tile;
    if (used[row] == tiles.size()) tiles.emplace_back(tile, kNoInput);
    tiles[used[row]++][row] = static_cast<int>(i);
  }
  return tiles;
}

// The frames of one tile: float[tile,size,size,3]. Row r shows the frame number rows[r] of `frames`, or zeros.
at::Tensor TileFrames(absl::string_view frames, absl::Span<const int> rows, int size) {
  const auto tile = static_cast<int64_t>(rows.size());
  const int64_t frame_bytes = int64_t{3} * size * size;
  const std::vector<uint8_t> no_frame(frame_bytes, 0);
  std::vector<const uint8_t*> row_frames(tile, no_frame.data());
  for (int64_t row = 0; row < tile; ++row) {
    if (rows[row] == kNoInput) continue;
    row_frames[row] = reinterpret_cast<const uint8_t*>(frames.data()) + rows[row] * frame_bytes;
  }
  at::Tensor input = at::empty({tile, size, size, 3});
  ScaleFrames(row_frames, frame_bytes, input.data_ptr<float>());
  return input;
}

std::optional<PatchGrid> PatchesOf(const AgentSpec& spec) {
  if (spec.network.objects() == v1::NetworkConfig::NO_OBJECTS) return std::nullopt;
  return PatchGrid{spec.frame_size, spec.network.patch(), spec.network.stride()};
}

// While it lives, the calling thread computes on `stream`; null: as before.
c10::OptionalStreamGuard OnStream(const c10::Stream* stream) {
  return stream != nullptr ? c10::OptionalStreamGuard(*stream) : c10::OptionalStreamGuard();
}

absl::Status CheckTile(int tile) {
  if (tile >= 1 && tile <= Policy::kMaxTile) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("tile is ", tile, ", want 1..", Policy::kMaxTile));
}

// Whether tiles that `device` computes can read `weights` where they are. The CPU reads them in another order.
bool IsOn(const std::string& device, const at::Tensor& weights) {
  if (device == kCpuDevice) return false;
  const at::Device wanted(device);
  return weights.device().type() == wanted.type() && (wanted.is_cpu() || weights.device() == wanted);
}

bool AllFinite(absl::Span<const float> values) {
  return std::all_of(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
}

}  // namespace

Policy::Policy(const AgentSpec& spec, std::shared_ptr<const void> owner, std::unique_ptr<const PolicyNet> net,
               std::unique_ptr<const c10::Stream> stream, int tile, const std::string& device)
    : agent_(spec.name),
      frame_bytes_(spec.frame_bytes()),
      frame_size_(spec.frame_size),
      state_size_(spec.state_size),
      has_memory_(spec.network.memory()),
      patches_(PatchesOf(spec)),
      tile_(tile),
      device_(device),
      owner_(std::move(owner)),
      stream_(std::move(stream)),
      net_(std::move(net)) {
  if (device_ == kCpuDevice || state_size_ == 0) return;
  Packing packing = Pack(std::vector<int>(tile, 1));
  for (at::Tensor* tensor : {&packing.rows, &packing.inverse_rows, &packing.segments, &packing.inverse_segments}) {
    *tensor = tensor->to(at::Device(device_));
  }
  packing_ = std::make_unique<Packing>(std::move(packing));
}

Policy::~Policy() = default;

absl::StatusOr<std::unique_ptr<const Policy>> Policy::Create(const AgentSpec& spec,
                                                             const std::shared_ptr<const PolicyWeights>& weights,
                                                             int tile, const std::string& device) {
  auto snapshot = std::dynamic_pointer_cast<const DeviceSnapshot>(weights);
  if (snapshot == nullptr || !IsOn(device, snapshot->flat())) {
    CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const std::string> bytes, weights->Bytes());
    return Create(spec, std::move(bytes), tile, device);
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckTile(tile));
  return Make(spec, tile, device, snapshot, [&] {
    snapshot->Await(CurrentStream(at::Device(device)));
    return std::make_unique<const PolicyNet>(spec, snapshot->params());
  });
}

absl::StatusOr<std::unique_ptr<const Policy>> Policy::Create(const AgentSpec& spec,
                                                             std::shared_ptr<const std::string> weights, int tile,
                                                             const std::string& device) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckTile(tile));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::shared_ptr<const float> values, ShareWeights(spec, std::move(weights)));
  CRAFTFLEET_RETURN_IF_ERROR(CheckPrecision(device, spec.precision));
  return Make(spec, tile, device, device == kCpuDevice ? values : nullptr, [&] {
    const auto span = absl::MakeSpan(const_cast<float*>(values.get()), spec.param_count);
    if (device == kCpuDevice) return std::make_unique<const PolicyNet>(spec, PolicyNet::Use::kActing, span);
    // In the order of snapshots: a GPU chooses its kernels by where numbers lie, and the same weights are to act alike
    // wherever they come from.
    const at::Tensor flat = SendFloats(Align(spec, span), at::Device(device));
    return std::make_unique<const PolicyNet>(spec, ParamsOf(AlignedSpec(spec), flat));
  });
}

absl::StatusOr<std::unique_ptr<const Policy>> Policy::Make(const AgentSpec& spec, int tile, const std::string& device,
                                                           std::shared_ptr<const void> owner,
                                                           absl::FunctionRef<std::unique_ptr<const PolicyNet>()> make) {
  try {
    std::unique_ptr<const c10::Stream> stream;
    if (spec.acting_stream && !at::Device(device).is_cpu()) {
      stream = std::make_unique<const c10::Stream>(ActingStream(at::Device(device)));
    }
    const c10::OptionalStreamGuard guard = OnStream(stream.get());
    std::unique_ptr<const PolicyNet> net = make();
    return std::unique_ptr<const Policy>(
        new Policy(spec, std::move(owner), std::move(net), std::move(stream), tile, device));
  } catch (const std::exception& error) {  // of LibTorch, out of a GPU's memory
    return ActingDeviceError("policy", error.what());
  }
}

absl::StatusOr<ActResult> Policy::Act(absl::string_view frames, absl::Span<const int> lanes,
                                      absl::Span<const double> noise, absl::Span<float> states) const {
  if (!noise.empty() && noise.size() != lanes.size()) {
    return absl::InvalidArgumentError(absl::StrCat(noise.size(), " noise values for ", lanes.size(), " lanes"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(Outputs outputs, Evaluate(frames, lanes, states));
  std::copy(outputs.states.begin(), outputs.states.end(), states.begin());
  ActResult result;
  for (size_t row = 0; row < lanes.size(); ++row) {
    const Categorical odds(&outputs.logits[row * kNumActions]);
    const Action action = noise.empty() ? odds.Greedy() : odds.Sample(noise[row]);
    result.actions.push_back(action);
    result.log_probs.push_back(static_cast<float>(odds.log_probs[static_cast<int>(action)]));
    result.odds.push_back(odds);
  }
  result.values = std::move(outputs.values);
  return result;
}

absl::StatusOr<std::vector<float>> Policy::Values(absl::string_view frames, absl::Span<const int> lanes,
                                                  absl::Span<const float> states) const {
  CRAFTFLEET_ASSIGN_OR_RETURN(Outputs outputs, Evaluate(frames, lanes, states));
  return std::move(outputs.values);
}

absl::StatusOr<AttentionMap> Policy::Attention(absl::string_view frame) const {
  if (!patches_.has_value()) {
    return absl::InvalidArgumentError(
        absl::StrCat("agent ", agent_, " has no attention to show; only oc_sa and oc_ca do"));
  }
  if (static_cast<int64_t>(frame.size()) != frame_bytes_) {
    return absl::InvalidArgumentError(absl::StrCat(frame.size(), " bytes of a frame, want ", frame_bytes_));
  }
  SetUpTorchThread();
  try {
    const c10::OptionalStreamGuard guard = OnStream(stream_.get());
    const c10::InferenceMode inference;
    at::Tensor input = at::empty({1, frame_size_, frame_size_, 3});
    ScaleFrames({reinterpret_cast<const uint8_t*>(frame.data())}, frame_bytes_, input.data_ptr<float>());
    const at::Tensor weights = net_->Attention(input.to(at::Device(device_))).cpu().contiguous();
    const float* values = weights.data_ptr<float>();
    return AttentionMap{*patches_, static_cast<int>(weights.size(1)), {values, values + weights.numel()}};
  } catch (const std::exception& error) {
    return ActingDeviceError("attention", error.what());
  }
}

absl::Status Policy::Remember(absl::string_view before, absl::string_view after, absl::Span<const int> lanes,
                              absl::Span<float> states) const {
  CRAFTFLEET_CHECK(has_memory_);
  CRAFTFLEET_RETURN_IF_ERROR(CheckInput(before, lanes, states));
  CRAFTFLEET_RETURN_IF_ERROR(CheckInput(after, lanes, states));
  SetUpTorchThread();
  std::vector<float> changes(states.size());
  try {
    const c10::OptionalStreamGuard guard = OnStream(stream_.get());
    const c10::InferenceMode inference;
    for (const std::vector<int>& rows : DealRows(lanes, tile_)) {
      const at::Tensor before_codes =
          net_->Codes(TileFrames(before, rows, frame_size_).to(at::Device(device_))).cpu().contiguous();
      const at::Tensor after_codes =
          net_->Codes(TileFrames(after, rows, frame_size_).to(at::Device(device_))).cpu().contiguous();
      const auto size = static_cast<size_t>(state_size_);
      for (int row = 0; row < tile_; ++row) {
        if (rows[row] == kNoInput) continue;
        CodeChange({before_codes.data_ptr<float>() + row * size, size},
                   {after_codes.data_ptr<float>() + row * size, size},
                   absl::MakeSpan(changes).subspan(rows[row] * size, size));
      }
    }
  } catch (const std::exception& error) {
    return ActingDeviceError("memory", error.what());
  }
  if (!AllFinite(changes)) return absl::InternalError("memory: the change of features is not finite");
  std::copy(changes.begin(), changes.end(), states.begin());
  return absl::OkStatus();
}

absl::Status Policy::CheckInput(absl::string_view frames, absl::Span<const int> lanes,
                                absl::Span<const float> states) const {
  if (frames.size() != lanes.size() * frame_bytes_) {
    return absl::InvalidArgumentError(
        absl::StrCat(frames.size(), " bytes of frames for ", lanes.size(), " lanes, want ", frame_bytes_, " a lane"));
  }
  if (states.size() != lanes.size() * state_size_) {
    return absl::InvalidArgumentError(absl::StrCat(states.size(), " floats of recurrent state for ", lanes.size(),
                                                   " lanes, want ", state_size_, " a lane"));
  }
  return absl::OkStatus();
}

absl::StatusOr<Policy::Outputs> Policy::Evaluate(absl::string_view frames, absl::Span<const int> lanes,
                                                 absl::Span<const float> states) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckInput(frames, lanes, states));
  SetUpTorchThread();
  Outputs outputs{std::vector<float>(lanes.size() * kNumActions), std::vector<float>(lanes.size()),
                  std::vector<float>(states.size())};
  try {
    const c10::OptionalStreamGuard guard = OnStream(stream_.get());
    const c10::InferenceMode inference;
    for (const std::vector<int>& rows : DealRows(lanes, tile_)) {
      if (device_ == kCpuDevice) {
        EvaluateTile(frames, rows, states, &outputs);
      } else {
        EvaluateTileOnDevice(frames, rows, states, &outputs);
      }
    }
  } catch (const std::exception& error) {
    return ActingDeviceError("policy", error.what());
  }
  if (!AllFinite(outputs.logits) || !AllFinite(outputs.values) || !AllFinite(outputs.states)) {
    return absl::InternalError("policy: logits, values or recurrent state are not finite");
  }
  return outputs;
}

void Policy::EvaluateTile(absl::string_view frames, absl::Span<const int> rows, absl::Span<const float> states,
                          Outputs* outputs) const {
  Segments segments{std::vector<int>(tile_, 1), at::zeros({tile_, state_size_})};
  for (int row = 0; row < tile_; ++row) {
    if (rows[row] == kNoInput) continue;
    std::copy_n(states.begin() + rows[row] * state_size_, state_size_,
                segments.states.data_ptr<float>() + row * state_size_);
  }
  const PolicyNet::Output output = net_->Forward(TileFrames(frames, rows, frame_size_), segments);
  for (int row = 0; row < tile_; ++row) {
    if (rows[row] == kNoInput) continue;
    std::copy_n(output.logits.data_ptr<float>() + row * kNumActions, kNumActions,
                outputs->logits.begin() + rows[row] * kNumActions);
    outputs->values[rows[row]] = output.values.data_ptr<float>()[row];
    if (state_size_ == 0) continue;
    std::copy_n(output.states.data_ptr<float>() + row * state_size_, state_size_,
                outputs->states.begin() + rows[row] * state_size_);
  }
}

void Policy::EvaluateTileOnDevice(absl::string_view frames, absl::Span<const int> rows, absl::Span<const float> states,
                                  Outputs* outputs) const {
  const at::Device device(device_);
  const auto for_sending = [&](at::ScalarType type) { return at::TensorOptions(type).pinned_memory(device.is_cuda()); };
  const at::Tensor host_frames = at::zeros({tile_, frame_size_, frame_size_, 3}, for_sending(at::kByte));
  const at::Tensor host_states = at::zeros({tile_, state_size_}, for_sending(at::kFloat));
  for (int row = 0; row < tile_; ++row) {
    if (rows[row] == kNoInput) continue;
    std::copy_n(reinterpret_cast<const uint8_t*>(frames.data()) + rows[row] * frame_bytes_, frame_bytes_,
                host_frames.data_ptr<uint8_t>() + row * frame_bytes_);
    std::copy_n(states.begin() + rows[row] * state_size_, state_size_,
                host_states.data_ptr<float>() + row * state_size_);
  }
  Segments segments;
  if (state_size_ > 0) {
    segments.lengths = std::vector<int>(tile_, 1);
    segments.states = host_states.to(device, /*non_blocking=*/true);
    segments.packing = *packing_;
  }
  const at::Tensor input = ScaleFrames(host_frames.to(device, /*non_blocking=*/true));
  const PolicyNet::Output output = net_->Forward(input, segments);
  std::vector<at::Tensor> parts = {output.logits, output.values.unsqueeze(1)};
  if (state_size_ > 0) parts.push_back(output.states);
  const at::Tensor fetched = at::cat(parts, 1).cpu();  // float[tile,17+1+state_size]
  for (int row = 0; row < tile_; ++row) {
    if (rows[row] == kNoInput) continue;
    const float* const values = fetched.data_ptr<float>() + row * fetched.size(1);
    std::copy_n(values, kNumActions, outputs->logits.begin() + rows[row] * kNumActions);
    outputs->values[rows[row]] = values[kNumActions];
    std::copy_n(values + kNumActions + 1, state_size_, outputs->states.begin() + rows[row] * state_size_);
  }
}

}  // namespace craftfleet
