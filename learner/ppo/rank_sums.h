// Sums over the learners ("ranks") that share out the gradient shards of each minibatch.

#pragma once

#include <cstddef>
#include <functional>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/ppo_loss.h"
#include "learner/ranks/rank_group.h"

namespace craftfleet {

// Consecutive shards: begin..end-1.
struct ShardRange {
  int begin = 0;
  int end = 0;
};

// Adds what the ranks have computed of a minibatch, shard by shard in order, so that all ranks get the bytes of one
// process. All ranks call the same functions in the same order; errors as those of RankGroup. Thread-compatible.
class RankSums {
 public:
  // `group` outlives this. `shards`: of a minibatch, at most.
  RankSums(const AgentSpec& spec, int shards, RankGroup* group);

  RankGroup* group() const { return group_; }

  // Begins an update, which rank 0 ends when `should_stop` says so.
  void Begin(std::function<bool()> should_stop) { should_stop_ = std::move(should_stop); }

  // Those of `shards`, at least as many as ranks, that this rank computes: as many as the others, give or take one.
  ShardRange OwnShards(int shards) const;

  // Replaces the gradients of this rank's shards, of which rank 0 has at least one, by the sum of all ranks', which is
  // valid until the next call; and `sums` by that of their losses. `own`: whether this rank has computed them; if not,
  // there are none.
  //   Cancelled: rank 0's should_stop said so.   Others: the error of the first rank that has one.
  absl::Status Add(const absl::Status& own, std::vector<ShardGradient>* gradients, absl::Span<const PpoLossSums> losses,
                   PpoLossSums* sums);

  // `values`, zero where other ranks have some, get those of all ranks.
  absl::Status Combine(std::vector<float>* values);

  // Whether rank 0's should_stop says so, or the group has ended.
  bool Stops();

 private:
  bool is_to_stop() const { return group_->rank() == 0 && should_stop_(); }
  const size_t params_;  // values of all parameters: a gradient has as many or fewer
  const int shards_;
  RankGroup* const group_;
  bool has_shared_memory_ = false;  // RankGroup::ShareMemory was called
  std::function<bool()> should_stop_;
  // Of the pieces of the last gradient that this rank had; before it, of the parameters that PPO trains.
  std::vector<size_t> sizes_;
  std::vector<float> total_;  // of the last gradients
};

}  // namespace craftfleet
