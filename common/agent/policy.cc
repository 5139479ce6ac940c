#include "common/agent/policy.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <utility>

#include <ATen/ATen.h>
#include <absl/status/status.h>
#include <absl/strings/str_cat.h>

#include "common/agent/categorical.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

// Which input each row of each tile shows.
using TileRows = std::vector<std::vector<int>>;
constexpr int kNoInput = -1;

// Deals inputs to the first tile whose row is free.
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

absl::optional<PatchGrid> PatchesOf(const AgentSpec& spec) {
  if (spec.network.objects() == v1::NetworkConfig::NO_OBJECTS) return absl::nullopt;
  return PatchGrid{spec.frame_size, spec.network.patch(), spec.network.stride()};
}

bool AllFinite(absl::Span<const float> values) {
  return std::all_of(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
}

}  // namespace

Policy::Policy(const AgentSpec& spec, std::vector<float> weights, int tile)
    : agent_(spec.name),
      frame_bytes_(spec.frame_bytes()),
      frame_size_(spec.frame_size),
      state_size_(spec.state_size),
      patches_(PatchesOf(spec)),
      tile_(tile),
      weights_(std::move(weights)),
      net_(std::make_unique<PolicyNet>(spec, PolicyNet::Use::kActing, absl::MakeSpan(weights_))) {}

Policy::~Policy() = default;

absl::StatusOr<std::unique_ptr<const Policy>> Policy::Create(const AgentSpec& spec, absl::string_view weights,
                                                             int tile) {
  if (tile < 1 || tile > kMaxTile) {
    return absl::InvalidArgumentError(absl::StrCat("tile is ", tile, ", want 1..", kMaxTile));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<float> values, LoadWeights(spec, weights));
  const auto bad = std::find_if_not(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
  if (bad != values.end()) {
    return absl::InvalidArgumentError(
        absl::StrCat(spec.name, ": weight ", bad - values.begin(), " is ", *bad, ", want finite numbers"));
  }
  return std::unique_ptr<const Policy>(new Policy(spec, std::move(values), tile));
}

absl::StatusOr<ActResult> Policy::Act(absl::string_view frames, absl::Span<const int> lanes,
                                      absl::Span<const double> noise, absl::Span<float> states) const {
  if (noise.size() != lanes.size()) {
    return absl::InvalidArgumentError(absl::StrCat(noise.size(), " noise values for ", lanes.size(), " lanes"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(Outputs outputs, Evaluate(frames, lanes, states));
  std::copy(outputs.states.begin(), outputs.states.end(), states.begin());
  return Choose(std::move(outputs), [&](size_t row, const Categorical& odds) { return odds.Sample(noise[row]); });
}

absl::StatusOr<ActResult> Policy::ActGreedily(absl::string_view frames, absl::Span<const int> lanes,
                                              absl::Span<float> states) const {
  CRAFTFLEET_ASSIGN_OR_RETURN(Outputs outputs, Evaluate(frames, lanes, states));
  std::copy(outputs.states.begin(), outputs.states.end(), states.begin());
  return Choose(std::move(outputs), [](size_t, const Categorical& odds) { return odds.Greedy(); });
}

absl::StatusOr<std::vector<float>> Policy::Values(absl::string_view frames, absl::Span<const int> lanes,
                                                  absl::Span<const float> states) const {
  CRAFTFLEET_ASSIGN_OR_RETURN(Outputs outputs, Evaluate(frames, lanes, states));
  return std::move(outputs.values);
}

absl::StatusOr<AttentionMap> Policy::Attention(absl::string_view frame) const {
  if (!patches_.has_value()) {
    return absl::InvalidArgumentError(
        absl::StrCat("agent ", agent_, " has no attention to show; oc_sa and oc_ca have"));
  }
  if (static_cast<int64_t>(frame.size()) != frame_bytes_) {
    return absl::InvalidArgumentError(absl::StrCat(frame.size(), " bytes of a frame, want ", frame_bytes_));
  }
  SetUpTorchThread();
  try {
    const c10::InferenceMode inference;
    at::Tensor input = at::empty({1, frame_size_, frame_size_, 3});
    ScaleFrames({reinterpret_cast<const uint8_t*>(frame.data())}, frame_bytes_, input.data_ptr<float>());
    const at::Tensor weights = net_->Attention(input).contiguous();
    const float* values = weights.data_ptr<float>();
    return AttentionMap{*patches_, static_cast<int>(weights.size(1)), {values, values + weights.numel()}};
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("attention: ", error.what()));
  }
}

ActResult Policy::Choose(Outputs outputs, absl::FunctionRef<Action(size_t, const Categorical&)> choose) {
  ActResult result;
  for (size_t row = 0; row < outputs.values.size(); ++row) {
    const Categorical odds(&outputs.logits[row * kNumActions]);
    const Action action = choose(row, odds);
    result.actions.push_back(action);
    result.log_probs.push_back(static_cast<float>(odds.log_probs[static_cast<int>(action)]));
  }
  result.values = std::move(outputs.values);
  return result;
}

absl::StatusOr<Policy::Outputs> Policy::Evaluate(absl::string_view frames, absl::Span<const int> lanes,
                                                 absl::Span<const float> states) const {
  if (frames.size() != lanes.size() * frame_bytes_) {
    return absl::InvalidArgumentError(
        absl::StrCat(frames.size(), " bytes of frames for ", lanes.size(), " lanes, want ", frame_bytes_, " a lane"));
  }
  if (states.size() != lanes.size() * state_size_) {
    return absl::InvalidArgumentError(absl::StrCat(states.size(), " floats of recurrent state for ", lanes.size(),
                                                   " lanes, want ", state_size_, " a lane"));
  }
  SetUpTorchThread();
  Outputs outputs{std::vector<float>(lanes.size() * kNumActions), std::vector<float>(lanes.size()),
                  std::vector<float>(states.size())};
  try {
    const c10::InferenceMode inference;
    for (const std::vector<int>& rows : DealRows(lanes, tile_)) EvaluateTile(frames, rows, states, &outputs);
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("policy: ", error.what()));
  }
  if (!AllFinite(outputs.logits) || !AllFinite(outputs.values) || !AllFinite(outputs.states)) {
    return absl::InternalError("policy: logits, values or recurrent state are not finite");
  }
  return outputs;
}

void Policy::EvaluateTile(absl::string_view frames, absl::Span<const int> rows, absl::Span<const float> states,
                          Outputs* outputs) const {
  const std::vector<uint8_t> no_frame(frame_bytes_, 0);
  std::vector<const uint8_t*> row_frames(tile_, no_frame.data());
  Segments segments{std::vector<int>(tile_, 1), at::zeros({tile_, state_size_})};
  for (int row = 0; row < tile_; ++row) {
    if (rows[row] == kNoInput) continue;
    row_frames[row] = reinterpret_cast<const uint8_t*>(frames.data()) + rows[row] * frame_bytes_;
    std::copy_n(states.begin() + rows[row] * state_size_, state_size_,
                segments.states.data_ptr<float>() + row * state_size_);
  }
  at::Tensor input = at::empty({tile_, frame_size_, frame_size_, 3});
  ScaleFrames(row_frames, frame_bytes_, input.data_ptr<float>());
  const PolicyNet::Output output = net_->Forward(input, segments);
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

}  // namespace craftfleet
