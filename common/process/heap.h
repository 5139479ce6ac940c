// The allocator: tcmalloc in programs that are linked with it (craftfleet_heap in cmake/craftfleet.cmake).

#ifndef CRAFTFLEET_COMMON_PROCESS_HEAP_H_
#define CRAFTFLEET_COMMON_PROCESS_HEAP_H_

// Defined by tcmalloc; null in tests and under sanitizers.
extern "C" void MallocExtension_ReleaseFreeMemory() __attribute__((weak));

namespace craftfleet {

// Returns free memory to the system, so that resident memory follows current use instead of the peak. Takes
// milliseconds; later allocations fault the pages in again. Thread-safe.
inline void ReleaseFreeMemory() {
  if (MallocExtension_ReleaseFreeMemory != nullptr) MallocExtension_ReleaseFreeMemory();
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_HEAP_H_
