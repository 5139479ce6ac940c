// A policy that acts: one version of an agent's weights, and what it does when it sees frames. No LibTorch here.

#ifndef CRAFTFLEET_COMMON_AGENT_POLICY_H_
#define CRAFTFLEET_COMMON_AGENT_POLICY_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <absl/functional/function_ref.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/optional.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/agent/attention_map.h"
#include "common/agent/categorical.h"
#include "common/crafter.h"

namespace craftfleet {

class PolicyNet;

// What a policy chose; rows stand in the order of the frames.
struct ActResult {
  std::vector<Action> actions;   // [n]
  std::vector<float> log_probs;  // [n] of the actions
  std::vector<float> values;     // [n]
};

// Computes in tiles of a fixed number of rows, lane l in row l mod `tile`, rows without a lane zero: what a lane gets
// depends neither on which lanes are beside it nor on their order, bit for bit.
// Immutable and thread-safe.
class Policy {
 public:
  static constexpr int kMaxTile = 1024;

  // `weights` are safetensors of the agent; tile in 1..kMaxTile.
  //   InvalidArgument: the weights are not this agent's or not finite, or the tile is out of range.
  static absl::StatusOr<std::unique_ptr<const Policy>> Create(const AgentSpec& spec, absl::string_view weights,
                                                              int tile);
  ~Policy();
  Policy(const Policy&) = delete;
  Policy& operator=(const Policy&) = delete;

  // Draws the action of each row: frame i of `frames`, uint8[n,H,W,3], was seen on lanes[i] (>= 0), and noise[i], in
  // [0,1), draws its action (see ActionNoise). A lane may come more than once.
  // `states`, float[n,state_size()], is the recurrent state of each row, zero where an episode begins; it becomes the
  // state after the step, unless the call fails.
  //   InvalidArgument: they don't have the same n.   Internal: LibTorch failed, or the output is not finite.
  absl::StatusOr<ActResult> Act(absl::string_view frames, absl::Span<const int> lanes, absl::Span<const double> noise,
                                absl::Span<float> states) const;

  // The same with the likeliest action of each row.
  absl::StatusOr<ActResult> ActGreedily(absl::string_view frames, absl::Span<const int> lanes,
                                        absl::Span<float> states) const;

  // float[n]: the values alone, to bootstrap from.
  absl::StatusOr<std::vector<float>> Values(absl::string_view frames, absl::Span<const int> lanes,
                                            absl::Span<const float> states) const;

  // Where the agent looks when it sees `frame`, uint8[H,W,3]. Costs about as much as acting on it once more.
  //   InvalidArgument: not the bytes of a frame, or an agent without attention.   Internal: LibTorch failed.
  absl::StatusOr<AttentionMap> Attention(absl::string_view frame) const;

  // Floats of recurrent state a lane; 0 for feed-forward agents, whose states are empty.
  int state_size() const { return state_size_; }

 private:
  struct Outputs {
    std::vector<float> logits;  // [n,17]
    std::vector<float> values;  // [n]
    std::vector<float> states;  // [n,state_size] after the step
  };

  Policy(const AgentSpec& spec, std::vector<float> weights, int tile);

  // `choose(row, distribution)` is the action of each row.
  static ActResult Choose(Outputs outputs, absl::FunctionRef<Action(size_t, const Categorical&)> choose);

  absl::StatusOr<Outputs> Evaluate(absl::string_view frames, absl::Span<const int> lanes,
                                   absl::Span<const float> states) const;
  // One tile: row r shows input rows[r]. Writes those inputs' outputs.
  void EvaluateTile(absl::string_view frames, absl::Span<const int> rows, absl::Span<const float> states,
                    Outputs* outputs) const;

  const std::string agent_;
  const int64_t frame_bytes_;
  const int frame_size_;
  const int state_size_;
  const absl::optional<PatchGrid> patches_;  // of agents with attention
  const int tile_;
  std::vector<float> weights_;  // float[param_count]; the net looks into it
  std::unique_ptr<const PolicyNet> net_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_POLICY_H_
