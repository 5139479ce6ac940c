#include "common/agent/attention_map.h"

#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::ElementsAreArray;
using testing::HasSubstr;

TEST(PatchGrid, CountsWholeSquares) {
  EXPECT_EQ((PatchGrid{72, 12, 8}.per_side()), 8);
  EXPECT_EQ((PatchGrid{72, 12, 8}.count()), 64);
  EXPECT_EQ((PatchGrid{72, 16, 16}.count()), 16);
  EXPECT_EQ((PatchGrid{72, 72, 5}.count()), 1);
  EXPECT_EQ((PatchGrid{3, 1, 1}.count()), 9);
}

TEST(SpreadOverPixels, AssignsEachPatchItsPixels) {
  EXPECT_THAT(SpreadOverPixels({4, 2, 2}, {1, 2, 3, 4}), ElementsAreArray<float>({1, 1, 2, 2,  //
                                                                                  1, 1, 2, 2,  //
                                                                                  3, 3, 4, 4,  //
                                                                                  3, 3, 4, 4}));
}

// The published overlay of OC-SA uses cells of the patch's size although the stride is smaller, and would shift them.
TEST(SpreadOverPixels, AveragesOverlappingPatches) {
  EXPECT_THAT(SpreadOverPixels({3, 2, 1}, {1, 2, 3, 8}), ElementsAreArray<float>({1, 1.5, 2,  //
                                                                                  2, 3.5, 5,  //
                                                                                  3, 5.5, 8}));
}

TEST(SpreadOverPixels, PixelsOutsideThePatchesAreZero) {
  EXPECT_THAT(SpreadOverPixels({3, 2, 2}, {5}), ElementsAreArray<float>({5, 5, 0,  //
                                                                         5, 5, 0,  //
                                                                         0, 0, 0}));
}

// Eight patches reach to pixel 67.
TEST(SpreadOverPixels, KeepsUniformAttentionUniform) {
  const std::vector<float> pixels = SpreadOverPixels({72, 12, 8}, std::vector<float>(64, 0.25F));
  for (int y = 0; y < 72; ++y) {
    for (int x = 0; x < 72; ++x) {
      ASSERT_FLOAT_EQ(pixels[y * 72 + x], x < 68 && y < 68 ? 0.25F : 0) << y << " " << x;
    }
  }
}

TEST(AttentionChoice, ParsesMeanSumAndIndices) {
  EXPECT_EQ(AttentionChoice::Parse("mean")->kind, AttentionChoice::Kind::kMean);
  EXPECT_EQ(AttentionChoice::Parse("sum")->kind, AttentionChoice::Kind::kSum);
  const AttentionChoice one = *AttentionChoice::Parse("7");
  EXPECT_EQ(one.kind, AttentionChoice::Kind::kOne);
  EXPECT_EQ(one.view, 7);
  for (const char* bad : {"", "max", "-1", "1.5", "7x", "99999999999"}) {
    EXPECT_THAT(AttentionChoice::Parse(bad), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want mean, sum")))
        << bad;
  }
}

TEST(AttentionChoice, SelectsAView) {
  const AttentionMap map = {{4, 2, 2}, 2, {0.25, 0.5, 0.25, 0, 0.75, 0, 0, 0.25}};
  EXPECT_THAT(*Choose(map, {AttentionChoice::Kind::kMean}), ElementsAre(0.5, 0.25, 0.125, 0.125));
  EXPECT_THAT(*Choose(map, {AttentionChoice::Kind::kSum}), ElementsAre(1, 0.5, 0.25, 0.25));
  EXPECT_THAT(*Choose(map, {AttentionChoice::Kind::kOne, 0}), ElementsAre(0.25, 0.5, 0.25, 0));
  EXPECT_THAT(*Choose(map, {AttentionChoice::Kind::kOne, 1}), ElementsAre(0.75, 0, 0, 0.25));
  EXPECT_THAT(Choose(map, {AttentionChoice::Kind::kOne, 2}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("heads or slots 0..1")));
}

}  // namespace
}  // namespace craftfleet
