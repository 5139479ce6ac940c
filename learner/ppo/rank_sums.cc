#include "learner/ppo/rank_sums.h"

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>

#include <absl/status/statusor.h>

#include "common/agent/nets/goal_predictor.h"
#include "common/base/status_macros.h"
#include "learner/ppo/update_state.h"

namespace craftfleet {

RankSums::RankSums(const AgentSpec& spec, int shards, RankGroup* group)
    : params_(spec.param_count), shards_(shards), group_(group) {
  for (const ParamSpec& param : spec.params) {
    if (!IsOfGoalPredictor(param.name)) sizes_.push_back(param.size);
  }
}

ShardRange RankSums::OwnShards(int shards) const {
  return {shards * group_->rank() / group_->size(), shards * (group_->rank() + 1) / group_->size()};
}

absl::Status RankSums::Add(const absl::Status& own, std::vector<ShardGradient>* gradients,
                           absl::Span<const PpoLossSums> losses, PpoLossSums* sums) {
  if (!gradients->empty()) {  // empty: a minibatch with fewer segments than shards, or no success
    sizes_.clear();
    for (const absl::Span<float> piece : gradients->front()) sizes_.push_back(piece.size());
  }
  const size_t length = std::accumulate(sizes_.begin(), sizes_.end(), size_t{0});
  if (!std::exchange(has_shared_memory_, true)) {
    const int terms = (shards_ + group_->size() - 1) / group_->size();
    CRAFTFLEET_RETURN_IF_ERROR(group_->ShareMemory(terms, params_));
  }
  total_.resize(length);
  std::vector<SumTerm> terms;
  for (const ShardGradient& gradient : *gradients) terms.emplace_back(gradient.begin(), gradient.end());
  if (!own.ok()) terms = {{absl::MakeConstSpan(total_)}};  // the sum, whatever it is, will not be used
  const absl::Span<float> total = absl::MakeSpan(total_);
  std::vector<Few> loss_terms;
  for (const PpoLossSums& loss : losses) {
    loss_terms.push_back({loss.policy_loss, loss.value_loss, loss.entropy, loss.approx_kl, loss.clipped});
  }
  Few all{};
  CRAFTFLEET_RETURN_IF_ERROR(group_->AgreeAndSum(is_to_stop() ? UpdateStopped() : own, loss_terms, &all, terms, total));
  *sums = {all[0], all[1], all[2], all[3], all[4]};
  ShardGradient sum;
  absl::Span<float> rest = total;
  for (const size_t size : sizes_) {
    sum.push_back(rest.subspan(0, size));
    rest.remove_prefix(size);
  }
  *gradients = {std::move(sum)};
  return absl::OkStatus();
}

absl::Status RankSums::Combine(std::vector<float>* values) {
  return group_->Sum({{absl::MakeConstSpan(*values)}}, absl::MakeSpan(*values));
}

bool RankSums::Stops() {
  const absl::StatusOr<bool> stops = group_->Share(is_to_stop());
  return !stops.ok() || *stops;
}

}  // namespace craftfleet
