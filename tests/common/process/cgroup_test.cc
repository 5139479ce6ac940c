#include "common/process/cgroup.h"

#include <filesystem>
#include <fstream>
#include <optional>
#include <string>

#include <gtest/gtest.h>

#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

constexpr int64_t kMiB = 1 << 20;

class CgroupTest : public testing::Test {
 protected:
  void Write(const std::string& name, const std::string& text) const {
    const std::filesystem::path path = root_ + "/" + name;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream(path) << text << "\n";
  }
  void Write(const std::string& name, int64_t number) const { Write(name, std::to_string(number)); }
  void Expect(const std::string& own, int64_t limit, int64_t left) const {
    const auto found = CgroupMemoryLimit(own, root_);
    ASSERT_TRUE(found.has_value());
    EXPECT_EQ(found->limit, limit);
    EXPECT_EQ(found->left, left);
  }

  const TempFolder folder_;
  const std::string root_ = folder_ / "cgroup";
};

TEST_F(CgroupTest, Version2sTightestGroupLimitsMemory) {
  Write("job/memory.max", 100 * kMiB);
  Write("job/memory.current", 40 * kMiB);
  Write("job/step/memory.max", "max");
  Write("job/step/memory.current", 30 * kMiB);
  Expect("0::/job/step\n", 100 * kMiB, 60 * kMiB);
  Write("memory.max", 90 * kMiB);
  Write("memory.current", 10 * kMiB);
  Expect("0::/job/step\n", 90 * kMiB, 60 * kMiB);
  Expect("0::/other\n", 90 * kMiB, 80 * kMiB);
}

TEST_F(CgroupTest, Version1sGroupOfTheControllerLimitsMemory) {
  Write("memory/memory.limit_in_bytes", "9223372036854771712");
  Write("memory/job/memory.limit_in_bytes", 100 * kMiB);
  Write("memory/job/memory.usage_in_bytes", 130 * kMiB);
  Expect("4:memory:/job/step\n0::/\n", 100 * kMiB, 0);
  EXPECT_FALSE(CgroupMemoryLimit("4:cpu:/job\n0::/\n", root_).has_value());
  EXPECT_FALSE(CgroupMemoryLimit("4:memory:/elsewhere\n", root_).has_value());
}

TEST_F(CgroupTest, CachedFilesCountAsFree) {
  Write("memory.max", 100 * kMiB);
  Write("memory.current", 90 * kMiB);
  Write("memory.stat", "anon 1\ninactive_file " + std::to_string(50 * kMiB) + "\nactive_file 7");
  Expect("0::/\n", 100 * kMiB, 60 * kMiB);
}

TEST_F(CgroupTest, WithoutALimitThereIsNone) {
  EXPECT_FALSE(CgroupMemoryLimit("", root_).has_value());
  Write("memory.max", "max");
  EXPECT_FALSE(CgroupMemoryLimit("0::/\n", root_).has_value());
}

TEST_F(CgroupTest, TheTightestQuotaOfAllGroupsAppliesInBothVersions) {
  Write("cpu.max", "800000 100000");
  Write("pod/cpu.max", "150000 100000");
  Write("pod/container/cpu.max", "max 100000");
  EXPECT_EQ(OwnCpuLimit("0::/pod/container\n", root_), 1.5);
  EXPECT_EQ(OwnCpuLimit("0::/elsewhere\n", root_), 8.0);
  EXPECT_EQ(OwnCpuLimit("0::/../../host/path\n", root_), 8.0) << "as in a container";
  EXPECT_EQ(OwnCpuLimit("0::/\n", root_ + "/pod/container"), std::nullopt);
  Write("cpu/docker/abc/cpu.cfs_quota_us", 300000);
  Write("cpu/docker/abc/cpu.cfs_period_us", 100000);
  Write("cpu/cpu.cfs_quota_us", -1);
  Write("cpu/cpu.cfs_period_us", 100000);
  EXPECT_EQ(OwnCpuLimit("12:memory:/pod\n5:cpu,cpuacct:/docker/abc\n2:cpuset:/pod\n0::/\n", root_), 3.0);
  EXPECT_EQ(OwnCpuLimit("5:cpu,cpuacct:/docker/abc\n0::/pod\n", root_), 1.5);
  EXPECT_EQ(OwnCpuLimit("5:cpu,cpuacct:/docker/none\n", root_), std::nullopt);
  EXPECT_EQ(OwnCpuLimit("12:memory:/docker/abc\n", root_), std::nullopt);
}

TEST_F(CgroupTest, WhatCannotBeReadIsNoQuota) {
  EXPECT_EQ(OwnCpuLimit("", root_), std::nullopt);
  EXPECT_EQ(OwnCpuLimit("no such text\n::\n", root_), std::nullopt);
  for (const char* text : {"-1 100000", "100000 0", "", "1 2 3", "many 100000"}) {
    Write("cpu.max", text);
    EXPECT_EQ(OwnCpuLimit("0::/\n", root_), std::nullopt) << text;
  }
  EXPECT_GE(DefaultThreads(), 1);
}

}  // namespace
}  // namespace craftfleet
