// Linked with craftfleet_heap, like the programs. Not built under sanitizers, which have their own allocator.

#include "common/process/heap.h"

#include <cstdint>
#include <cstring>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/process_usage.h"
#include "tests/fakes/command_output.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr size_t kBlock = 1 << 18;
constexpr int kBlocks = 64;
constexpr int kThreads = 16;

void HoldForAMoment() {
  std::vector<std::unique_ptr<char[]>> blocks;
  for (int i = 0; i < kBlocks; ++i) {
    blocks.emplace_back(new char[kBlock]);
    std::memset(blocks.back().get(), i + 1, kBlock);
  }
}

// With glibc's malloc each of these threads would keep its freed memory.
TEST(Heap, MemoryFreedByOneThreadIsReusedByAnother) {
  HoldForAMoment();
  const int64_t before = ResidentMemoryBytes();
  std::promise<void> end;
  const std::shared_future<void> ended = end.get_future().share();
  std::vector<std::thread> threads;
  for (int i = 0; i < kThreads; ++i) {
    std::promise<void> turn;
    const std::future<void> turn_over = turn.get_future();
    threads.emplace_back([turn = std::move(turn), ended]() mutable {
      HoldForAMoment();
      turn.set_value();
      ended.wait();
    });
    turn_over.wait();
  }
  EXPECT_LT(ResidentMemoryBytes(), before + static_cast<int64_t>(2 * kBlocks * kBlock));
  end.set_value();
  for (std::thread& thread : threads) thread.join();
}

TEST(Heap, ReleaseFreeMemoryReducesResidentMemoryAtMostOnceInHalfAMinute) {
  constexpr int64_t kFreed = kBlocks * kBlock / 2;
  const absl::Time start = SteadyNow();
  ReleaseFreeMemory(start);
  const int64_t before = ResidentMemoryBytes();
  HoldForAMoment();
  ReleaseFreeMemory(start + absl::Seconds(29));
  EXPECT_GT(ResidentMemoryBytes(), before + kFreed);
  ReleaseFreeMemory(start + absl::Seconds(30));
  EXPECT_LT(ResidentMemoryBytes(), before + kFreed);
}

TEST(Heap, ReleasesMuchFreeMemoryAtOnce) {
  constexpr size_t kMuch = size_t{600} << 20;
  const absl::Time start = SteadyNow() + absl::Hours(1);
  ReleaseFreeMemory(start);
  const int64_t before = ResidentMemoryBytes();
  { const std::string freed(kMuch, 'x'); }
  EXPECT_GT(ResidentMemoryBytes(), before + static_cast<int64_t>(kMuch / 2));
  ReleaseFreeMemory(start + absl::Seconds(1));
  EXPECT_LT(ResidentMemoryBytes(), before + static_cast<int64_t>(kMuch / 2));
}

class HeapOf : public testing::TestWithParam<const char*> {};

TEST_P(HeapOf, IsTcmalloc) {
  EXPECT_THAT(OutputOf(absl::StrCat("ldd ", BuiltProgram(GetParam()))), HasSubstr("libtcmalloc_minimal"));
}

INSTANTIATE_TEST_SUITE_P(Programs, HeapOf,
                         testing::Values("craftfleet-learner", "craftfleet-actor", "craftfleet-envserver",
                                         "craftfleet-torch"));

}  // namespace
}  // namespace craftfleet
