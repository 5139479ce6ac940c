// Tests on each CPU path: a suite that derives from OnEachCpuPath runs on the path of its parameter. On a CPU without
// the path its tests are skipped, and say so.
//
//     using NoiseField = OnEachCpuPath;
//     TEST_P(NoiseField, IsExact) { ... }
//     CRAFTFLEET_ON_EACH_CPU_PATH(NoiseField);

#pragma once

#include <optional>

#include <gtest/gtest.h>

#include "common/base/cpu_path.h"

namespace craftfleet {

class OnEachCpuPath : public testing::TestWithParam<CpuPath> {
 protected:
  void SetUp() override {
    if (!CpuHas(GetParam())) GTEST_SKIP() << "this CPU has no " << CpuPathName(GetParam());
    forced_.emplace(GetParam());
  }

 private:
  std::optional<ScopedCpuPath> forced_;
};

}  // namespace craftfleet

#define CRAFTFLEET_ON_EACH_CPU_PATH(suite)                                         \
  INSTANTIATE_TEST_SUITE_P(Cpu, suite, testing::ValuesIn(::craftfleet::kCpuPaths), \
                           [](const auto& path) { return ::craftfleet::CpuPathName(path.param); })
