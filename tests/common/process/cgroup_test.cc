#include "common/process/cgroup.h"

#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

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

TEST_F(CgroupTest, FoldersAreThoseOfTheControllerUpToTheTop) {
  EXPECT_THAT(CgroupFolders("4:cpu,memory:/a/b\n3:cpuset:/c\n0::/d\n", "memory", "/r"),
              ElementsAre("/r/memory/a/b", "/r/memory/a", "/r/memory", "/r/d", "/r"));
  EXPECT_THAT(CgroupFolders("0::/\n", "cpu", "/r"), ElementsAre("/r"));
  EXPECT_THAT(CgroupFolders("no such text\n", "cpu", "/r"), IsEmpty());
}

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

}  // namespace
}  // namespace craftfleet
