#include "common/process/closest_name.h"

#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

const std::vector<std::string>& Names() {
  static const auto* const names = new std::vector<std::string>{"agent", "env", "eval_env", "lanes", "logdir", "steps"};
  return *names;
}

TEST(ClosestName, FindsNamesWithOneTypingError) {
  EXPECT_EQ(ClosestName("lnes", Names()), "lanes");    // a letter is missing
  EXPECT_EQ(ClosestName("laanes", Names()), "lanes");  // one too many
  EXPECT_EQ(ClosestName("lames", Names()), "lanes");   // another one
  EXPECT_EQ(ClosestName("lanse", Names()), "lanes");   // two swapped
  EXPECT_EQ(ClosestName("logidr", Names()), "logdir");
  EXPECT_EQ(ClosestName("evn", Names()), "env");
  EXPECT_EQ(ClosestName("eval-env", Names()), "eval_env");
}

TEST(ClosestName, FindsNothingForUnrelatedWords) {
  EXPECT_EQ(ClosestName("nope", Names()), "");
  EXPECT_EQ(ClosestName("checkpoint", Names()), "");
  EXPECT_EQ(ClosestName("", Names()), "");
  EXPECT_EQ(ClosestName("lanes", {}), "");
  EXPECT_EQ(ClosestName(std::string(1 << 20, 'x'), {std::string(1 << 20, 'x')}), "") << "too long for a mistyped name";
}

TEST(ClosestName, PrefersTheClosestThenTheFirst) {
  EXPECT_EQ(ClosestName("stepz", {"stop", "steps"}), "steps");
  EXPECT_EQ(ClosestName("lane", {"lanes", "plane"}), "lanes");
}

}  // namespace
}  // namespace craftfleet
