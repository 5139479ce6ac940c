// A policy: one version of an agent's weights, which chooses actions for frames. Does not include LibTorch.

#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/functional/function_ref.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/agent/attention_map.h"
#include "common/agent/categorical.h"
#include "common/agent/policy_weights.h"
#include "common/base/crafter.h"

namespace c10 {
class Stream;
}

namespace craftfleet {

class PolicyNet;
struct Packing;

// The choices of a policy; rows are in the order of the frames.
struct ActResult {
  std::vector<Action> actions;    // [n]
  std::vector<float> log_probs;   // [n] of the actions
  std::vector<float> values;      // [n]
  std::vector<Categorical> odds;  // [n]: the distributions of the actions
};

// Computes in tiles of a fixed number of rows, lane l in row l mod `tile`, rows without a lane zero: the result of
// a lane does not depend on the other lanes or on their order, bit for bit.
// Immutable and thread-safe.
class Policy {
 public:
  static constexpr int kMaxTile = 1024;

  // `weights` are the agent's; the policy looks into their bytes, or, if they are in the memory of `device`, there.
  // tile in 1..kMaxTile. `device`, as FindDevice returns it, computes tiles; it gets a tile's frames and states in one
  // copy each and returns all results in one.
  //   InvalidArgument: the weights are not this agent's or not finite, the tile is out of range, or the device does not
  //   compute in the agent's precision.   Others as ActingDeviceError (common/agent/device.h).
  static absl::StatusOr<std::unique_ptr<const Policy>> Create(const AgentSpec& spec,
                                                              const std::shared_ptr<const PolicyWeights>& weights,
                                                              int tile, const std::string& device = "cpu");
  // Of safetensors.
  static absl::StatusOr<std::unique_ptr<const Policy>> Create(const AgentSpec& spec,
                                                              std::shared_ptr<const std::string> weights, int tile,
                                                              const std::string& device = "cpu");
  static absl::StatusOr<std::unique_ptr<const Policy>> Create(const AgentSpec& spec, std::string weights, int tile,
                                                              const std::string& device = "cpu") {
    return Create(spec, std::make_shared<const std::string>(std::move(weights)), tile, device);
  }
  ~Policy();
  Policy(const Policy&) = delete;
  Policy& operator=(const Policy&) = delete;

  // Chooses the action of each row: frame i of `frames`, uint8[n,H,W,3], was seen on lanes[i] (>= 0), and noise[i], in
  // [0,1), draws its action (see ActionNoise); without any noise it is the most probable one. A lane may occur more
  // than once. `states`, float[n,state_size()], is the recurrent state or memory of each row, zero where an episode
  // begins; it becomes the state after the step, unless the call fails. A memory stays as it is: see Remember.
  //   InvalidArgument: they don't have the same n.   Internal: LibTorch failed, or the output is not finite.   Others,
  //   on a GPU, as ActingDeviceError.
  absl::StatusOr<ActResult> Act(absl::string_view frames, absl::Span<const int> lanes, absl::Span<const double> noise,
                                absl::Span<float> states) const;

  // float[n]: the values alone, for bootstrapping.
  absl::StatusOr<std::vector<float>> Values(absl::string_view frames, absl::Span<const int> lanes,
                                            absl::Span<const float> states) const;

  // Whether the agent has a memory of its last achievement.
  bool has_memory() const { return has_memory_; }

  // Agents with a memory: to be called for the rows whose step unlocked an achievement and did not end the episode.
  // `before` and `after` are the frames that the step began and ended with, uint8[n,H,W,3]; each row of `states`
  // becomes the change of their features (common/agent/code_change.h), unless the call fails.
  //   InvalidArgument: they don't have the same n.   Internal: LibTorch failed, or the result is not finite.
  absl::Status Remember(absl::string_view before, absl::string_view after, absl::Span<const int> lanes,
                        absl::Span<float> states) const;

  // The agent's attention to the patches of `frame`, uint8[H,W,3]. Takes about as long as acting on it.
  //   InvalidArgument: not the bytes of a frame, or an agent without attention.   Internal: LibTorch failed.
  absl::StatusOr<AttentionMap> Attention(absl::string_view frame) const;

  // Floats of recurrent state or memory a lane; 0 for agents without, whose states are empty.
  int state_size() const { return state_size_; }

 private:
  struct Outputs {
    std::vector<float> logits;  // [n,17]
    std::vector<float> values;  // [n]
    std::vector<float> states;  // [n,state_size] after the step
  };

  // `owner` of the memory that `net` looks into; both in `stream`'s order. Null: in that of the default stream.
  Policy(const AgentSpec& spec, std::shared_ptr<const void> owner, std::unique_ptr<const PolicyNet> net,
         std::unique_ptr<const c10::Stream> stream, int tile, const std::string& device);

  // Of the net that `make` returns, with the device's acting stream as the current one if `spec` wants it.
  static absl::StatusOr<std::unique_ptr<const Policy>> Make(const AgentSpec& spec, int tile, const std::string& device,
                                                            std::shared_ptr<const void> owner,
                                                            absl::FunctionRef<std::unique_ptr<const PolicyNet>()> make);

  absl::StatusOr<Outputs> Evaluate(absl::string_view frames, absl::Span<const int> lanes,
                                   absl::Span<const float> states) const;
  absl::Status CheckInput(absl::string_view frames, absl::Span<const int> lanes, absl::Span<const float> states) const;
  // One tile: row r shows input rows[r]. Writes those inputs' outputs.
  void EvaluateTile(absl::string_view frames, absl::Span<const int> rows, absl::Span<const float> states,
                    Outputs* outputs) const;
  void EvaluateTileOnDevice(absl::string_view frames, absl::Span<const int> rows, absl::Span<const float> states,
                            Outputs* outputs) const;

  const std::string agent_;
  const int64_t frame_bytes_;
  const int frame_size_;
  const int state_size_;
  const bool has_memory_;
  const std::optional<PatchGrid> patches_;  // of agents with attention
  const int tile_;
  const std::string device_;
  const std::shared_ptr<const void> owner_;
  const std::unique_ptr<const c10::Stream> stream_;
  std::unique_ptr<const PolicyNet> net_;
  std::unique_ptr<const Packing> packing_;  // on the device, of a tile's rows; recurrent agents on another device only
};

}  // namespace craftfleet
