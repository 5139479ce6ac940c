// Which steps of a rollout make up each minibatch of an epoch.

#pragma once

#include <cstdint>
#include <vector>

#include <absl/types/span.h>

#include "learner/ppo/rollout.h"

namespace craftfleet {

// Determines an epoch's random choices.
struct EpochKey {
  uint64_t run_seed = 0;
  int64_t iteration = 0;
  int epoch = 0;
};

constexpr int kPadding = -1;

// The steps of one optimiser step.
struct Minibatch {
  std::vector<int> rows;     // of the rollout, segment after segment; kPadding: a step of zeros
  std::vector<int> lengths;  // of the segments, which the network sees as sequences; empty: each step stands alone
};

// The elements of `values` at `rows`; `padding` for kPadding.
template <typename T>
std::vector<T> Gather(const std::vector<T>& values, absl::Span<const int> rows, T padding = T()) {
  std::vector<T> chosen;
  chosen.reserve(rows.size());
  for (const int row : rows) chosen.push_back(row == kPadding ? padding : values[row]);
  return chosen;
}

// A permutation of 0..count-1, each equally likely.
std::vector<int> ShuffledOrder(const EpochKey& key, int count);

// All steps in a shuffled order, `size` in each minibatch. n is a multiple of `size`.
std::vector<Minibatch> StepMinibatches(const EpochKey& key, int n, int size);

// For recurrent agents: fragments, cut where an episode starts, are segments. Their order is shuffled; each minibatch
// takes whole ones in that order and ends where a segment does, as near as can be to the next multiple of `size`. Every
// step is in one minibatch; there are n / size of them, fewer only where a segment is longer than `size`, and their
// sizes differ from `size` by at most the length of the longest segment.
std::vector<Minibatch> SegmentMinibatches(const EpochKey& key, absl::Span<const RowStart> starts, int size);

// The same as the published code does it: the rollout, turned so that it begins at a random step, is cut into
// slices of `size` steps (the last may be shorter), these into segments at episode and lane starts. Zeros fill all
// segments of a minibatch up to the longest, and count in every mean.
// Source: PPO.md, section 5; golden `recurrent_minibatches`.
std::vector<Minibatch> PublishedMinibatches(const EpochKey& key, absl::Span<const RowStart> starts, int size);

// At most `shards` parts that hold the minibatch's segments, each whole, the longest ones dealt first, each to the part
// that has fewest steps by then; without segments, equal consecutive parts.
std::vector<Minibatch> CutIntoShards(const Minibatch& minibatch, int shards);

}  // namespace craftfleet
