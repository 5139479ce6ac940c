// The allocator: tcmalloc in programs that are linked with it (craftfleet_heap in cmake/craftfleet.cmake).

#ifndef CRAFTFLEET_COMMON_PROCESS_HEAP_H_
#define CRAFTFLEET_COMMON_PROCESS_HEAP_H_

#include "common/base/find_symbol.h"

namespace craftfleet {

// Returns free memory to the system, so that resident memory follows current use instead of the peak. Takes
// milliseconds; later allocations fault the pages in again. Thread-safe.
inline void ReleaseFreeMemory() {
  // Of tcmalloc; null in tests and under sanitizers.
  static auto* const release = FindSymbol<void()>("MallocExtension_ReleaseFreeMemory");
  if (release != nullptr) release();
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_HEAP_H_
