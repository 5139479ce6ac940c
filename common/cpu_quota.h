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

// The tightest limit of a process whose /proc/self/cgroup has the text `own_cgroups`, where `root` ("/sys/fs/cgroup")
// has version 2's tree, or version 1's in `root`/cpu, or both. Within a container the path is often that of the host,
// of which only the top can be seen: what holds for the container stands there.
absl::optional<double> OwnCpuLimit(absl::string_view own_cgroups, const std::string& root);

// Threads of one process that are worth having: whole CPUs of the cgroup's quota and the affinity mask, at least 1.
int DefaultThreads();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CPU_QUOTA_H_
