// What programs allocate with: tcmalloc (craftfleet_heap in cmake/craftfleet.cmake), where they are linked with it.

#ifndef CRAFTFLEET_COMMON_HEAP_H_
#define CRAFTFLEET_COMMON_HEAP_H_

// tcmalloc's; null in tests and under sanitizers.
extern "C" void MallocExtension_ReleaseFreeMemory() __attribute__((weak));

namespace craftfleet {

// Gives what is free back to the system, so that memory follows what is in use instead of the most that ever was. Takes
// milliseconds; whoever allocates then faults the pages in again. Thread-safe.
inline void ReleaseFreeMemory() {
  if (MallocExtension_ReleaseFreeMemory != nullptr) MallocExtension_ReleaseFreeMemory();
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_HEAP_H_
