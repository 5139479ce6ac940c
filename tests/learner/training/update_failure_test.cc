#include "learner/training/update_failure.h"

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::EndsWith;
using testing::SizeIs;
using testing::StartsWith;

Fragment From(const std::string& sender, int lane, int64_t number, float log_prob = 0, float value = 0) {
  Fragment fragment;
  fragment.sender = sender;
  fragment.lane = lane;
  fragment.number = number;
  fragment.log_probs = {-1, log_prob};
  fragment.values = {0.5F, value};
  return fragment;
}

TEST(DescribeSenders, ListsEachSendersFragmentsAndExtremes) {
  EXPECT_THAT(DescribeSenders({From("b", 0, 7, -2), From("a", 1, 7, -104, -30), From("b", 1, 8, -3, 4)}),
              ElementsAre("from a (lane/fragment): 1/7; log_probs down to -104, values up to 30",
                          "from b (lane/fragment): 0/7 1/8; log_probs down to -3, values up to 4"));
}

TEST(DescribeSenders, IsBounded) {
  std::vector<Fragment> fragments;
  for (int i = 0; i < 100; ++i) fragments.push_back(From("a", i, 1000));
  for (int i = 0; i < 20; ++i) fragments.push_back(From(absl::StrCat("b", i), 0, 0));
  const std::vector<std::string> lines = DescribeSenders(fragments);
  ASSERT_THAT(lines, SizeIs(17));
  EXPECT_THAT(lines[0], StartsWith("from a (lane/fragment): 0/1000 1/1000"));
  EXPECT_THAT(lines[0], EndsWith("...; log_probs down to -1, values up to 0.5"));
  EXPECT_LT(lines[0].size(), 400u);
  EXPECT_EQ(lines[16], "and 5 more");
}

}  // namespace
}  // namespace craftfleet
