#include "common/process/program.h"

#include <sys/resource.h>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(Program, RaisesTheFileLimitToTheHardLimit) {
  rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  rlimit low = before;
  low.rlim_cur = before.rlim_max / 2;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &low), 0);
  char name[] = "program";
  char* arguments[] = {name, nullptr};
  ParseFlags({"program", "what it is for"}, 1, arguments);
  rlimit after = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &after), 0);
  EXPECT_EQ(after.rlim_cur, before.rlim_max);
}

}  // namespace
}  // namespace craftfleet
