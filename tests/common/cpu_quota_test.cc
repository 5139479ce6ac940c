#include "common/cpu_quota.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

void Write(const std::filesystem::path& path, const std::string& text) {
  std::filesystem::create_directories(path.parent_path());
  std::ofstream(path) << text;
}

TEST(CpuQuota, ParsesQuotaOverPeriod) {
  EXPECT_EQ(ParseCpuMax("150000 100000\n"), 1.5);
  EXPECT_EQ(ParseCpuMax("400000\n 100000\n"), 4.0);  // version 1's two files, one after the other
  EXPECT_EQ(ParseCpuMax("max 100000\n"), absl::nullopt);
  EXPECT_EQ(ParseCpuMax("-1 100000"), absl::nullopt);
  EXPECT_EQ(ParseCpuMax("100000 0"), absl::nullopt);
  EXPECT_EQ(ParseCpuMax(""), absl::nullopt);
  EXPECT_EQ(ParseCpuMax("1 2 3"), absl::nullopt);
}

TEST(CpuQuota, TightestLimitUpTheTreeCounts) {
  const std::string root = ::testing::TempDir() + "/cpu_quota_test";
  Write(root + "/cpu.max", "800000 100000");
  Write(root + "/pod/cpu.max", "200000 100000");
  Write(root + "/pod/container/cpu.max", "max 100000");
  Write(root + "/old/cpu.cfs_quota_us", "300000\n");
  Write(root + "/old/cpu.cfs_period_us", "100000\n");
  EXPECT_EQ(CgroupCpuLimit(root, "/pod/container"), 2.0);
  EXPECT_EQ(CgroupCpuLimit(root, "/old"), 3.0);
  EXPECT_EQ(CgroupCpuLimit(root, "/elsewhere"), 8.0);
  EXPECT_EQ(CgroupCpuLimit(root, "/"), 8.0);
  EXPECT_EQ(CgroupCpuLimit(root + "/pod/container", "/"), absl::nullopt);
  std::filesystem::remove_all(root);
}

TEST(CpuQuota, DefaultIsAtLeastOneThread) { EXPECT_GE(DefaultThreads(), 1); }

}  // namespace
}  // namespace craftfleet
