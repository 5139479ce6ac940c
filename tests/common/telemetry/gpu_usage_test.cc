#include "common/telemetry/gpu_usage.h"

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(Nvml, ReportsAGpuByNumberAndIdentifier) {
  const auto nvml = Nvml::Open(CRAFTFLEET_STAND_IN_NVML);
  ASSERT_NE(nvml, nullptr);
  const std::optional<GpuUsage> first = nvml->Read("0");
  ASSERT_TRUE(first.has_value());
  EXPECT_EQ(first->name, "NVIDIA First");
  EXPECT_EQ(first->memory_bytes, int64_t{3} << 30);
  EXPECT_EQ(first->memory_total_bytes, int64_t{80} << 30);
  EXPECT_EQ(first->utilization, 0.87);
  EXPECT_EQ(first->capability, 75);
  const std::optional<GpuUsage> second = nvml->Read("GPU-1234");
  ASSERT_TRUE(second.has_value());
  EXPECT_EQ(second->name, "NVIDIA Second");
  EXPECT_EQ(second->capability, 90);
  EXPECT_EQ(second->utilization, 0) << "not reported";
  EXPECT_FALSE(nvml->Read("2").has_value());
  EXPECT_FALSE(nvml->Read("GPU-unknown").has_value());
}

TEST(Nvml, IsNullWithoutALibraryOrItsFunctions) {
  EXPECT_EQ(Nvml::Open("libno-such-library.so.1"), nullptr);
  EXPECT_EQ(Nvml::Open("libc.so.6"), nullptr);
}

TEST(NvmlName, IsTheEntryOfTheVisibleDevices) {
  EXPECT_EQ(NvmlName(0, ""), "0");
  EXPECT_EQ(NvmlName(3, ""), "3");
  EXPECT_EQ(NvmlName(1, "4,6"), "6");
  EXPECT_EQ(NvmlName(0, "GPU-1234"), "GPU-1234");
  EXPECT_EQ(NvmlName(2, "4,6"), "2");
}

TEST(ReadGpuUsage, IsNothingOnTheCpu) { EXPECT_FALSE(ReadGpuUsage().has_value()); }

}  // namespace
}  // namespace craftfleet
