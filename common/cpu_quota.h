// How many CPUs this process may use.

#ifndef CRAFTFLEET_COMMON_CPU_QUOTA_H_
#define CRAFTFLEET_COMMON_CPU_QUOTA_H_

#include <string>

#include <absl/strings/string_view.h>
#include <absl/types/optional.h>

namespace craftfleet {

// CPUs of a cgroup v2 `cpu.max` ("150000 100000" is 1.5); nullopt: "max", no limit, or not such a text.
absl::optional<double> ParseCpuMax(absl::string_view text);

// The tightest limit on the way from cgroup `path` ("/a/b") up to `root` ("/sys/fs/cgroup"), both cgroup versions;
// nullopt where there is none.
absl::optional<double> CgroupCpuLimit(const std::string& root, const std::string& path);

// Threads of one process that are worth having: whole CPUs of the cgroup's quota and the affinity mask, at least 1.
int DefaultThreads();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CPU_QUOTA_H_
