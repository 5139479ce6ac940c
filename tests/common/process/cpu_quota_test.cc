#include "common/process/cpu_quota.h"

#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>

#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

void Write(const std::filesystem::path& path, const std::string& text) {
  std::filesystem::create_directories(path.parent_path());
  std::ofstream(path) << text;
}

TEST(CpuQuota, ParsesQuotaOverPeriod) {
  EXPECT_EQ(ParseCpuMax("150000 100000\n"), 1.5);
  EXPECT_EQ(ParseCpuMax("400000\n 100000\n"), 4.0);  // version 1's two files, one after the other
  EXPECT_EQ(ParseCpuMax("max 100000\n"), std::nullopt);
  EXPECT_EQ(ParseCpuMax("-1 100000"), std::nullopt);
  EXPECT_EQ(ParseCpuMax("100000 0"), std::nullopt);
  EXPECT_EQ(ParseCpuMax(""), std::nullopt);
  EXPECT_EQ(ParseCpuMax("1 2 3"), std::nullopt);
}

TEST(CpuQuota, TightestLimitOfAllAncestorsApplies) {
  const TempFolder folder;
  const std::string root = folder / "cgroup";
  Write(root + "/cpu.max", "800000 100000");
  Write(root + "/pod/cpu.max", "200000 100000");
  Write(root + "/pod/container/cpu.max", "max 100000");
  Write(root + "/old/cpu.cfs_quota_us", "300000\n");
  Write(root + "/old/cpu.cfs_period_us", "100000\n");
  EXPECT_EQ(OwnCpuLimit("0::/pod/container", root), 2.0);
  EXPECT_EQ(OwnCpuLimit("0::/old", root), 3.0);
  EXPECT_EQ(OwnCpuLimit("0::/elsewhere", root), 8.0);
  EXPECT_EQ(OwnCpuLimit("0::/", root), 8.0);
  EXPECT_EQ(OwnCpuLimit("0::/", root + "/pod/container"), std::nullopt);
}

class OwnCpuLimitTest : public ::testing::Test {
 protected:
  const TempFolder folder_;
  const std::string root_ = folder_ / "cgroup";
};

TEST_F(OwnCpuLimitTest, Version2UsesTheGroupOfTheProcess) {
  Write(root_ + "/kubepods/pod1/cpu.max", "250000 100000\n");
  Write(root_ + "/kubepods/pod2/cpu.max", "100000 100000\n");
  EXPECT_EQ(OwnCpuLimit("0::/kubepods/pod1/container\n", root_), 2.5);
  EXPECT_EQ(OwnCpuLimit("0::/system.slice\n", root_), std::nullopt);
}

TEST_F(OwnCpuLimitTest, Version1UsesTheCpuController) {
  Write(root_ + "/cpu/docker/abc/cpu.cfs_quota_us", "300000\n");
  Write(root_ + "/cpu/docker/abc/cpu.cfs_period_us", "100000\n");
  Write(root_ + "/cpu/other/cpu.cfs_quota_us", "100000\n");
  Write(root_ + "/cpu/other/cpu.cfs_period_us", "100000\n");
  EXPECT_EQ(OwnCpuLimit("12:memory:/other\n5:cpu,cpuacct:/docker/abc\n2:cpuset:/other\n0::/other\n", root_), 3.0);
  EXPECT_EQ(OwnCpuLimit("12:memory:/docker/abc\n", root_), std::nullopt);
}

// A container sees its own limit at the root of the tree, whatever its path on the host.
TEST_F(OwnCpuLimitTest, InAContainerTheTopLevelLimitApplies) {
  Write(root_ + "/cpu.max", "150000 100000\n");
  EXPECT_EQ(OwnCpuLimit("0::/\n", root_), 1.5);
  EXPECT_EQ(OwnCpuLimit("0::/../../host/path\n", root_), 1.5);
  std::filesystem::remove_all(root_);
  Write(root_ + "/cpu/cpu.cfs_quota_us", "200000\n");
  Write(root_ + "/cpu/cpu.cfs_period_us", "100000\n");
  EXPECT_EQ(OwnCpuLimit("5:cpu,cpuacct:/docker/0123abc\n", root_), 2.0);
}

TEST_F(OwnCpuLimitTest, TheTighterOfBothVersionsApplies) {
  Write(root_ + "/cpu/cpu.cfs_quota_us", "400000\n");
  Write(root_ + "/cpu/cpu.cfs_period_us", "100000\n");
  Write(root_ + "/slice/cpu.max", "200000 100000\n");
  EXPECT_EQ(OwnCpuLimit("1:cpu:/\n0::/slice\n", root_), 2.0);
}

TEST_F(OwnCpuLimitTest, IsUnlimitedWhenNothingCanBeRead) {
  EXPECT_EQ(OwnCpuLimit("", root_), std::nullopt);
  EXPECT_EQ(OwnCpuLimit("no such text\n::\n", root_), std::nullopt);
}

TEST(CpuQuota, DefaultIsAtLeastOneThread) { EXPECT_GE(DefaultThreads(), 1); }

}  // namespace
}  // namespace craftfleet
