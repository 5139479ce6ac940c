// The control groups that limit this process, for both versions of cgroups.

#ifndef CRAFTFLEET_COMMON_PROCESS_CGROUP_H_
#define CRAFTFLEET_COMMON_PROCESS_CGROUP_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// The folders of the groups of a process with the text `own_cgroups` in /proc/self/cgroup that limit `controller`
// ("cpu", "memory"), each before the one above it. `root` ("/sys/fs/cgroup") has the tree of version 2, that of version
// 1 in `root`/`controller`, or both. In a container the path is often the host's, and only the top exists: the
// container's own limit is there.
std::vector<std::string> CgroupFolders(absl::string_view own_cgroups, absl::string_view controller,
                                       const std::string& root);

// Bytes of memory.
struct MemoryLimit {
  int64_t limit = 0;  // that the processes of the tightest group may use together
  int64_t left = 0;   // the least that a group leaves; files that are cached count as free
};

// nullopt: no group has a limit.   Arguments as CgroupFolders.
std::optional<MemoryLimit> CgroupMemoryLimit(absl::string_view own_cgroups, const std::string& root);

// That of this process.
std::optional<MemoryLimit> OwnMemoryLimit();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_CGROUP_H_
