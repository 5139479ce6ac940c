// The control groups that limit this process, for both versions of cgroups.

#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Bytes of memory.
struct MemoryLimit {
  int64_t limit = 0;  // that the processes of the tightest group may use together
  int64_t left = 0;   // the least that a group leaves; files that are cached count as free
};

// The limit of a process with the text `own_cgroups` in /proc/self/cgroup; nullopt: no group has one. `root` is
// "/sys/fs/cgroup".
std::optional<MemoryLimit> CgroupMemoryLimit(absl::string_view own_cgroups, const std::string& root);

// That of this process.
std::optional<MemoryLimit> OwnMemoryLimit();

// The tightest limit in CPUs, likewise; nullopt: no quota.
std::optional<double> OwnCpuLimit(absl::string_view own_cgroups, const std::string& root);

// The default number of threads: whole CPUs that the cgroup's quota and the affinity mask allow, at least 1.
int DefaultThreads();

}  // namespace craftfleet
