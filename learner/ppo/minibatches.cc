#include "learner/ppo/minibatches.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "common/base/keyed_random.h"

namespace craftfleet {
namespace {

// Consecutive rows of a rollout.
struct Segment {
  int first;
  int length;
};

uint64_t BitsOf(const EpochKey& key) {
  return KeyedBits(RandomUse::kMinibatchOrder, key.run_seed, static_cast<uint64_t>(key.iteration),
                   static_cast<uint64_t>(key.epoch));
}

// Adds `length` rows from `first` on and padding up to `padded_length`, as one segment.
void AppendSegment(const Segment& segment, int padded_length, Minibatch* minibatch) {
  const size_t begin = minibatch->rows.size();
  minibatch->rows.resize(begin + padded_length, kPadding);
  std::iota(minibatch->rows.begin() + begin, minibatch->rows.begin() + begin + segment.length, segment.first);
  minibatch->lengths.push_back(padded_length);
}

std::vector<Segment> CutAtStarts(absl::Span<const RowStart> starts) {
  std::vector<Segment> segments;
  for (int row = 0; row < static_cast<int>(starts.size()); ++row) {
    if (starts[row] != RowStart::kNone || row == 0) segments.push_back({row, 0});
    ++segments.back().length;
  }
  return segments;
}

// The segments of `length` steps from `first` on, around the rollout's end.
std::vector<Segment> CutSlice(absl::Span<const RowStart> starts, int first, int length) {
  std::vector<Segment> segments;
  for (int i = 0; i < length; ++i) {
    const int row = (first + i) % static_cast<int>(starts.size());
    const bool continues = starts[row] == RowStart::kNone || starts[row] == RowStart::kFragment;
    if (i == 0 || row == 0 || !continues) segments.push_back({row, 0});
    ++segments.back().length;
  }
  return segments;
}

}  // namespace

std::vector<int> ShuffledOrder(const EpochKey& key, int count) {
  const uint64_t seed = BitsOf(key);
  std::vector<int> order(count);
  std::iota(order.begin(), order.end(), 0);
  // Fisher and Yates. 53 random bits leave a bias below 2^-30 for any count that fits memory.
  for (int last = count - 1; last > 0; --last) {
    const double uniform = UnitInterval(KeyedBits(RandomUse::kMinibatchOrder, seed, static_cast<uint64_t>(last), 0));
    std::swap(order[last], order[static_cast<int>(uniform * (last + 1))]);
  }
  return order;
}

std::vector<Minibatch> StepMinibatches(const EpochKey& key, int n, int size) {
  const std::vector<int> order = ShuffledOrder(key, n);
  std::vector<Minibatch> minibatches;
  for (auto first = order.begin(); first != order.end(); first += size) {
    minibatches.push_back({{first, first + size}, {}});
  }
  return minibatches;
}

std::vector<Minibatch> SegmentMinibatches(const EpochKey& key, absl::Span<const RowStart> starts, int size) {
  const std::vector<Segment> segments = CutAtStarts(starts);
  std::vector<Minibatch> minibatches(1);
  int done = 0;       // steps that are in minibatches
  int target = size;  // where the minibatch should end
  for (const int i : ShuffledOrder(key, static_cast<int>(segments.size()))) {
    const int length = segments[i].length;
    for (; target - done <= done + length - target; target += size) {
      if (!minibatches.back().rows.empty()) minibatches.emplace_back();
    }
    AppendSegment(segments[i], length, &minibatches.back());
    done += length;
  }
  return minibatches;
}

std::vector<Minibatch> PublishedMinibatches(const EpochKey& key, absl::Span<const RowStart> starts, int size) {
  const int n = static_cast<int>(starts.size());
  const int split = static_cast<int>(UnitInterval(BitsOf(key)) * n);
  std::vector<Minibatch> minibatches;
  for (int begin = 0; begin < n; begin += size) {
    const std::vector<Segment> segments = CutSlice(starts, split + begin, std::min(size, n - begin));
    int longest = 0;
    for (const Segment& segment : segments) longest = std::max(longest, segment.length);
    minibatches.emplace_back();
    for (const Segment& segment : segments) AppendSegment(segment, longest, &minibatches.back());
  }
  return minibatches;
}

std::vector<Minibatch> CutIntoShards(const Minibatch& minibatch, int shards) {
  const auto rows = minibatch.rows.begin();
  std::vector<Minibatch> parts(shards);
  if (minibatch.lengths.empty()) {
    const auto size = static_cast<int>(minibatch.rows.size()) / shards;
    for (int i = 0; i < shards; ++i) parts[i].rows.assign(rows + i * size, rows + (i + 1) * size);
    return parts;
  }
  std::vector<Segment> segments;
  int first = 0;
  for (const int length : minibatch.lengths) {
    segments.push_back({first, length});
    first += length;
  }
  std::stable_sort(segments.begin(), segments.end(),
                   [](const Segment& a, const Segment& b) { return a.length > b.length; });
  for (const Segment& segment : segments) {
    Minibatch& part = *std::min_element(parts.begin(), parts.end(), [](const Minibatch& a, const Minibatch& b) {
      return a.rows.size() < b.rows.size();
    });
    const auto begin = rows + segment.first;
    part.rows.insert(part.rows.end(), begin, begin + segment.length);
    part.lengths.push_back(segment.length);
  }
  parts.resize(std::min(parts.size(), segments.size()));
  return parts;
}

}  // namespace craftfleet
