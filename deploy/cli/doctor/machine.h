// Reads the facts about this machine that the checks of craftfleet doctor evaluate.

#ifndef CRAFTFLEET_DEPLOY_CLI_DOCTOR_MACHINE_H_
#define CRAFTFLEET_DEPLOY_CLI_DOCTOR_MACHINE_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "deploy/cli/doctor/checks.h"

namespace craftfleet {

CpuFacts ReadCpu();
BlasFacts ReadBlas();

// Bytes: MemAvailable in `meminfo`, the text of /proc/meminfo; 0: unknown.
int64_t AvailableMemory(absl::string_view meminfo);
// The lesser of that and of what this process' cgroups leave.
int64_t ReadAvailableMemory();

uint64_t ReadOpenFilesLimit();

// Writes a few files into `logdir`, or into the nearest existing folder above it, and removes them.
DiskFacts MeasureDisk(const std::string& logdir);

ClockFacts ReadClock();

// Bytes of the file system at /dev/shm.
std::optional<int64_t> ReadSharedMemory();

GpuFacts ReadGpu();

// Listens on `address`, HOST:PORT, for a moment; port 0 is always free.
absl::Status TryPort(const std::string& address);

// The versions of CraftFleet, its libraries and the kernel.
std::vector<std::pair<std::string, std::string>> ReadVersions();

// The first file in `maps` (the text of /proc/self/maps) whose name contains one of `names`; empty if there is none.
std::string MappedFile(absl::string_view maps, const std::vector<absl::string_view>& names);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_DOCTOR_MACHINE_H_
