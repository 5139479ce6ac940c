// Adam (Kingma & Ba 2015) over a flat array of parameters, with clipping by the global gradient norm.

#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <absl/types/span.h>

#include "common/base/worker_pool.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

inline constexpr double kAdamBeta1 = 0.9;
inline constexpr double kAdamBeta2 = 0.999;

struct AdamState {
  int64_t steps = 0;              // taken so far
  std::vector<float> exp_avg;     // [parameters] running mean of the gradient
  std::vector<float> exp_avg_sq;  // [parameters] and of its square
};

// One shard's gradient: consecutive pieces (parameters) of the first weights: of all, or of all but a goal predictor's,
// which then stay as they are. In shards after the first, a piece may be empty: it is in the first one's already.
using ShardGradient = std::vector<absl::Span<float>>;

// The squares of a piece are added in blocks of so many values from its start. That is fixed, so that the norm depends
// neither on the number of threads nor on how many pieces of whole blocks a parameter is in.
inline constexpr size_t kAdamBlock = 16384;

// Adds the gradients of the shards in their order into the first, then takes one step on `weights`, in place. At least
// one shard; all are cut into the same pieces. Shares the work out over `workers`; their number does not change a bit
// of the result. Returns the L2 norm of the summed gradient before clipping; if it is not finite, weights and state are
// untouched. The fields of `config` that count: learning_rate, adam_epsilon and max_gradient_norm.
double AdamStep(const v1::PpoConfig& config, absl::Span<const ShardGradient> shards, absl::Span<float> weights,
                AdamState* state, WorkerPool* workers);

}  // namespace craftfleet
