// Undoes the binding of threads to cores that OpenMP is asked for with OMP_PROC_BIND, OMP_PLACES or GOMP_CPU_AFFINITY.

#pragma once

#include <sched.h>

#include <vector>

#include "common/base/find_symbol.h"

namespace craftfleet {

// Lets the calling thread, and those that it starts from now on, run on the CPUs of all of OpenMP's places. With such a
// binding the OpenMP library moves the initial thread to the first place when it is loaded; threads that are not
// OpenMP's inherit that, and all of them would share one core. Does nothing without OpenMP or without places.
inline void UseAllOpenMpPlaces() {
  static auto* const count_places = FindSymbol<int()>("omp_get_num_places");
  static auto* const count_cpus = FindSymbol<int(int place)>("omp_get_place_num_procs");
  static auto* const list_cpus = FindSymbol<void(int place, int* ids)>("omp_get_place_proc_ids");
  if (count_places == nullptr || count_cpus == nullptr || list_cpus == nullptr) return;
  cpu_set_t cpus;
  if (sched_getaffinity(0, sizeof(cpus), &cpus) != 0) return;
  const int before = CPU_COUNT(&cpus);
  for (int place = 0; place < count_places(); ++place) {
    std::vector<int> ids(count_cpus(place));
    list_cpus(place, ids.data());
    for (const int id : ids) CPU_SET(id, &cpus);
  }
  if (CPU_COUNT(&cpus) > before) sched_setaffinity(0, sizeof(cpus), &cpus);
}

}  // namespace craftfleet
