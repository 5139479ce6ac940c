#include "common/base/worker_pool.h"

#include <atomic>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(WorkerPool, RunsEachPartOnceAndMakesItsResultVisible) {
  for (const int threads : {1, 2, 5}) {
    WorkerPool pool(threads, [] {});
    EXPECT_EQ(pool.threads(), threads);
    for (int job = 0; job < 200; ++job) {
      std::vector<int> calls(job % 7, 0);  // not atomic: ThreadSanitizer would see a part run twice or too late
      pool.Run(static_cast<int>(calls.size()), [&](int part) { ++calls[part]; });
      EXPECT_EQ(calls, std::vector<int>(job % 7, 1));
    }
  }
}

TEST(WorkerPool, EachStartedThreadCallsOnStart) {
  std::atomic<int> starts{0};
  {
    WorkerPool pool(4, [&] { ++starts; });
  }
  EXPECT_EQ(starts, 3);
}

TEST(WorkerPool, RunsPartsConcurrently) {
  WorkerPool pool(2, [] {});
  // Each part waits for the other: with one thread this would deadlock.
  std::atomic<int> here{0};
  pool.Run(2, [&](int) {
    ++here;
    while (here < 2) std::this_thread::yield();
  });
  EXPECT_EQ(here, 2);
}

}  // namespace
}  // namespace craftfleet
