#include "learner/ppo/minibatches.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/keyed_random.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

constexpr RowStart kNone = RowStart::kNone;
constexpr RowStart kFragment = RowStart::kFragment;
constexpr RowStart kLane = RowStart::kLane;
constexpr RowStart kEpisode = RowStart::kEpisode;

// `lanes` lanes of `steps` steps in fragments of `fragment`; episodes end at random, one step in `episode_length`.
std::vector<RowStart> RandomStarts(uint64_t seed, int lanes, int steps, int fragment, int episode_length) {
  std::vector<RowStart> starts;
  for (int row = 0; row < lanes * steps; ++row) {
    const bool begins = ActionNoise(seed, 0, row) * episode_length < 1;
    starts.push_back(begins ? kEpisode : row % steps == 0 ? kLane : row % fragment == 0 ? kFragment : kNone);
  }
  return starts;
}

std::vector<int> AllRows(const std::vector<Minibatch>& minibatches) {
  std::vector<int> rows;
  for (const Minibatch& minibatch : minibatches) {
    for (const int row : minibatch.rows) {
      if (row != kPadding) rows.push_back(row);
    }
  }
  return rows;
}

// Each step once.
void ExpectEachRowOnce(const std::vector<Minibatch>& minibatches, int n) {
  std::vector<int> rows = AllRows(minibatches);
  std::sort(rows.begin(), rows.end());
  std::vector<int> wanted(n);
  std::iota(wanted.begin(), wanted.end(), 0);
  EXPECT_EQ(rows, wanted);
}

// The segments of a minibatch, without their padding.
std::vector<std::vector<int>> SegmentsOf(const Minibatch& minibatch) {
  std::vector<std::vector<int>> segments;
  auto row = minibatch.rows.begin();
  for (const int length : minibatch.lengths) {
    segments.emplace_back();
    for (int i = 0; i < length; ++i, ++row) {
      if (*row != kPadding) segments.back().push_back(*row);
    }
  }
  EXPECT_EQ(row, minibatch.rows.end()) << "lengths add up";
  return segments;
}

TEST(ShuffledOrder, IsAPermutation) {
  for (const int count : {0, 1, 2, 4096}) {
    std::vector<int> order = ShuffledOrder({1, 2, 3}, count);
    std::vector<int> expected(count);
    std::iota(expected.begin(), expected.end(), 0);
    std::sort(order.begin(), order.end());
    EXPECT_EQ(order, expected);
  }
}

TEST(ShuffledOrder, FollowsFromSeedIterationAndEpoch) {
  const std::vector<int> order = ShuffledOrder({1, 2, 3}, 4096);
  EXPECT_EQ(ShuffledOrder({1, 2, 3}, 4096), order);
  EXPECT_NE(ShuffledOrder({2, 2, 3}, 4096), order);
  EXPECT_NE(ShuffledOrder({1, 3, 3}, 4096), order);
  EXPECT_NE(ShuffledOrder({1, 2, 4}, 4096), order);
}

TEST(ShuffledOrder, EveryOrderIsEquallyLikely) {
  std::array<int, 64> counts{};  // by the order's digits, base 4
  constexpr int kOrders = 24000;
  for (int iteration = 0; iteration < kOrders; ++iteration) {
    const std::vector<int> order = ShuffledOrder({3, iteration, 0}, 4);
    ++counts[order[0] * 16 + order[1] * 4 + order[2]];
  }
  double chi_square = 0;
  int orders = 0;
  for (const int count : counts) {
    if (count == 0) continue;
    ++orders;
    chi_square += (count - 1000.0) * (count - 1000.0) / 1000.0;
  }
  EXPECT_EQ(orders, 24);
  EXPECT_LT(chi_square, 49.7);  // 23 degrees of freedom: 1 in 1000
}

TEST(StepMinibatches, AreConsecutivePiecesOfTheOrder) {
  const std::vector<Minibatch> minibatches = StepMinibatches({1, 2, 3}, 96, 32);
  ASSERT_EQ(minibatches.size(), 3);
  EXPECT_EQ(AllRows(minibatches), ShuffledOrder({1, 2, 3}, 96));
  EXPECT_EQ(minibatches[1].rows.size(), 32);
  EXPECT_THAT(minibatches[1].lengths, IsEmpty());
}

TEST(SegmentMinibatches, HoldWholeSegmentsEachStepOnceCloseToTheSize) {
  constexpr int kSize = 128;
  for (uint64_t seed = 0; seed < 50; ++seed) {
    for (const int fragment : {16, 64, 128}) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << ", fragments of " << fragment);
      const std::vector<RowStart> starts = RandomStarts(seed, 16, 256, fragment, 1 + static_cast<int>(seed) * 5);
      const std::vector<Minibatch> minibatches = SegmentMinibatches({seed, 2, 3}, starts, kSize);
      EXPECT_EQ(minibatches.size(), starts.size() / kSize);
      ExpectEachRowOnce(minibatches, static_cast<int>(starts.size()));
      for (const Minibatch& minibatch : minibatches) {
        EXPECT_LE(minibatch.rows.size(), kSize + fragment);
        EXPECT_GE(minibatch.rows.size() + fragment, kSize);
        for (const std::vector<int>& segment : SegmentsOf(minibatch)) {
          ASSERT_NE(starts[segment[0]], kNone);
          for (size_t i = 1; i < segment.size(); ++i) {
            ASSERT_EQ(segment[i], segment[0] + static_cast<int>(i));
            ASSERT_EQ(starts[segment[i]], kNone);
          }
          const auto after = static_cast<size_t>(segment.back()) + 1;
          ASSERT_TRUE(after == starts.size() || starts[after] != kNone);
        }
      }
    }
  }
}

TEST(SegmentMinibatches, AreOthersInEveryEpoch) {
  const std::vector<RowStart> starts = RandomStarts(1, 16, 256, 64, 100);
  const std::vector<int> rows = AllRows(SegmentMinibatches({1, 2, 3}, starts, 128));
  EXPECT_EQ(AllRows(SegmentMinibatches({1, 2, 3}, starts, 128)), rows);
  EXPECT_NE(AllRows(SegmentMinibatches({1, 2, 4}, starts, 128)), rows);
  EXPECT_NE(AllRows(SegmentMinibatches({1, 3, 3}, starts, 128)), rows);
  EXPECT_NE(AllRows(SegmentMinibatches({2, 2, 3}, starts, 128)), rows);
}

TEST(SegmentMinibatches, ASegmentLongerThanAMinibatchIsOneOfItsOwn) {
  const std::vector<RowStart> starts = RandomStarts(1, 4, 256, 256, 1 << 30);
  const std::vector<Minibatch> minibatches = SegmentMinibatches({1, 2, 3}, starts, 128);
  ASSERT_EQ(minibatches.size(), 4);
  for (const Minibatch& minibatch : minibatches) EXPECT_THAT(minibatch.lengths, ElementsAre(256));
}

// Seeds of which the split is wanted: what PublishedMinibatches begins with.
EpochKey KeyWithSplit(absl::Span<const RowStart> starts, int split) {
  EpochKey key{1, 0, 0};
  while (PublishedMinibatches(key, starts, 1)[0].rows[0] != split) ++key.iteration;
  return key;
}

// The paper's authors' own example: golden agents/lstm_cnn.json, `recurrent_minibatches`.
TEST(PublishedMinibatches, AreThoseOfTheGolden) {
  std::vector<RowStart> starts(24, kNone);
  starts[0] = kLane;
  for (const int row : {4, 13, 14}) starts[row] = kEpisode;
  const std::vector<Minibatch> minibatches = PublishedMinibatches(KeyWithSplit(starts, 9), starts, 16);
  ASSERT_EQ(minibatches.size(), 2);
  EXPECT_THAT(minibatches[0].lengths, ElementsAre(10, 10, 10, 10));
  EXPECT_THAT(minibatches[0].rows, ElementsAre(9, 10, 11, 12, -1, -1, -1, -1, -1, -1,   //
                                               13, -1, -1, -1, -1, -1, -1, -1, -1, -1,  //
                                               14, 15, 16, 17, 18, 19, 20, 21, 22, 23,  //
                                               0, -1, -1, -1, -1, -1, -1, -1, -1, -1));
  EXPECT_THAT(minibatches[1].lengths, ElementsAre(5, 5));
  EXPECT_THAT(minibatches[1].rows, ElementsAre(1, 2, 3, -1, -1, 4, 5, 6, 7, 8));
}

TEST(PublishedMinibatches, GoOnFromFragmentToFragmentButNotFromLaneToLane) {
  const std::vector<RowStart> starts = {kLane, kNone, kFragment, kNone, kLane, kNone, kFragment, kNone};
  const std::vector<Minibatch> minibatches = PublishedMinibatches(KeyWithSplit(starts, 1), starts, 8);
  ASSERT_EQ(minibatches.size(), 1);
  EXPECT_THAT(SegmentsOf(minibatches[0]), ElementsAre(ElementsAre(1, 2, 3), ElementsAre(4, 5, 6, 7), ElementsAre(0)));
}

TEST(PublishedMinibatches, HoldEachStepOnceAndBeginAnywhere) {
  const std::vector<RowStart> starts = RandomStarts(1, 16, 256, 64, 100);
  std::set<int> splits;
  for (int epoch = 0; epoch < 100; ++epoch) {
    const std::vector<Minibatch> minibatches = PublishedMinibatches({1, 2, epoch}, starts, 128);
    EXPECT_EQ(minibatches.size(), 32);
    ExpectEachRowOnce(minibatches, static_cast<int>(starts.size()));
    splits.insert(minibatches[0].rows[0]);
  }
  EXPECT_GT(splits.size(), 90);
  EXPECT_GT(*splits.rbegin(), 3900);
  EXPECT_LT(*splits.begin(), 200);
}

TEST(CutIntoShards, IndependentStepsAreCutIntoEqualPieces) {
  const std::vector<Minibatch> parts = CutIntoShards({{7, 5, 3, 1, 0, 2}, {}}, 3);
  ASSERT_EQ(parts.size(), 3);
  EXPECT_THAT(parts[0].rows, ElementsAre(7, 5));
  EXPECT_THAT(parts[2].rows, ElementsAre(0, 2));
}

TEST(CutIntoShards, SegmentsStayWholeAndAreSpreadEvenly) {
  const std::vector<Minibatch> parts = CutIntoShards({{0, 1, 10, 11, 12, 20, 30, 31, 32, 33}, {2, 3, 1, 4}}, 2);
  ASSERT_EQ(parts.size(), 2);
  EXPECT_THAT(parts[0].rows, ElementsAre(30, 31, 32, 33, 20));
  EXPECT_THAT(parts[0].lengths, ElementsAre(4, 1));
  EXPECT_THAT(parts[1].rows, ElementsAre(10, 11, 12, 0, 1));
  EXPECT_THAT(parts[1].lengths, ElementsAre(3, 2));
}

TEST(CutIntoShards, NoPartIsEmpty) {
  const std::vector<Minibatch> parts = CutIntoShards({{0, 1, 2, 9}, {3, 1}}, 4);
  ASSERT_EQ(parts.size(), 2);
  EXPECT_THAT(parts[0].rows, ElementsAre(0, 1, 2));
  EXPECT_THAT(parts[1].rows, ElementsAre(9));
}

}  // namespace
}  // namespace craftfleet
