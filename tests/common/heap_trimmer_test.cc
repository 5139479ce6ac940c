#include "common/heap_trimmer.h"

#include <cstring>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "common/process_usage.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/sanitizers.h"

namespace craftfleet {
namespace {

constexpr size_t kBlock = 1 << 20;
constexpr int kBlocks = 64;

TEST(HeapTrimmer, GivesFreeMemoryBackNowAndThen) {
  if (kAddressSanitizer) GTEST_SKIP() << "it has a heap of its own";
  // As learners and actors do (SetUpTorchProcess): what is free is kept.
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  FakeClock clock;
  HeapTrimmer heap(&clock);
  std::vector<std::unique_ptr<char[]>> blocks;
  for (int i = 0; i < kBlocks; ++i) {
    blocks.emplace_back(new char[kBlock]);
    std::memset(blocks.back().get(), i + 1, kBlock);
  }
  blocks.clear();
  const int64_t full = ResidentMemoryBytes();
  clock.Advance(absl::Seconds(9));
  heap.MayTrim();
  EXPECT_GT(ResidentMemoryBytes(), full - static_cast<int64_t>(kBlocks * kBlock) / 2);
  clock.Advance(absl::Seconds(1));
  heap.MayTrim();
  EXPECT_LT(ResidentMemoryBytes(), full - static_cast<int64_t>(kBlocks * kBlock) / 2);
}

}  // namespace
}  // namespace craftfleet
