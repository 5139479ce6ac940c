// How many CPUs this process may use.

#ifndef CRAFTFLEET_COMMON_PROCESS_CPU_QUOTA_H_
#define CRAFTFLEET_COMMON_PROCESS_CPU_QUOTA_H_

#include <optional>
#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

// The number of CPUs in a cgroup v2 `cpu.max` ("150000 100000" is 1.5); nullopt: "max" (no limit), or malformed text.
std::optional<double> ParseCpuMax(absl::string_view text);

// The tightest limit, in CPUs, of the groups of a process; nullopt: no quota.   Arguments as CgroupFolders (cgroup.h).
std::optional<double> OwnCpuLimit(absl::string_view own_cgroups, const std::string& root);

// The default number of threads: whole CPUs that the cgroup's quota and the affinity mask allow, at least 1.
int DefaultThreads();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_CPU_QUOTA_H_
