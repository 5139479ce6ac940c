// The allocator: tcmalloc in programs that are linked with it (craftfleet_heap in cmake/craftfleet.cmake).

#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/find_symbol.h"

namespace craftfleet {

// Free memory that a process should give back at once, bytes; the pages of less would soon be faulted in again.
inline constexpr size_t kMuchFreeMemory = size_t{1} << 29;

// Returns free memory to the system, so that resident memory follows recent use instead of the peak. With less than
// kMuchFreeMemory at most once in half a minute; other calls do nothing, since the next iteration would fault the
// same pages in again, which costs a run of short iterations 3% of its speed. `now`: as SteadyNow(). Thread-safe.
inline void ReleaseFreeMemory(absl::Time now = SteadyNow()) {
  constexpr int64_t kEveryNs = 30'000'000'000;
  static std::atomic<int64_t> next_ns{std::numeric_limits<int64_t>::min()};
  const int64_t now_ns = absl::ToUnixNanos(now);
  // Of tcmalloc; null in tests and under sanitizers.
  static auto* const release = FindSymbol<void()>("MallocExtension_ReleaseFreeMemory");
  static auto* const property = FindSymbol<int(const char*, size_t*)>("MallocExtension_GetNumericProperty");
  size_t free_bytes = 0;
  const bool is_much = property != nullptr && property("tcmalloc.pageheap_free_bytes", &free_bytes) != 0 &&
                       free_bytes >= kMuchFreeMemory;
  int64_t next = next_ns;
  if (!is_much && now_ns < next) return;
  if (!next_ns.compare_exchange_strong(next, now_ns + kEveryNs)) return;
  if (release != nullptr) release();
}

}  // namespace craftfleet
