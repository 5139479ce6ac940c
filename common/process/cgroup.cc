#include "common/process/cgroup.h"

#include <sched.h>

#include <algorithm>
#include <limits>

#include <absl/strings/ascii.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>

#include "common/io/files.h"

namespace craftfleet {
namespace {

// Version 1 writes "no limit" as a number near 2^63.
constexpr int64_t kNoLimit = std::numeric_limits<int64_t>::max() / 2;

// The folders of the groups of a process with the text `own_cgroups` in /proc/self/cgroup that limit `controller`
// ("cpu", "memory"), each before the one above it. `root` ("/sys/fs/cgroup") has the tree of version 2, that of version
// 1 in `root`/`controller`, or both. In a container the path is often the host's, and only the top exists: the
// container's own limit is there.
std::vector<std::string> CgroupFolders(absl::string_view own_cgroups, absl::string_view controller,
                                       const std::string& root) {
  std::vector<std::string> folders;
  for (const absl::string_view line : absl::StrSplit(own_cgroups, '\n')) {
    const std::vector<absl::string_view> fields = absl::StrSplit(line, absl::MaxSplits(':', 2));
    if (fields.size() != 3) continue;
    const std::vector<absl::string_view> controllers = absl::StrSplit(fields[1], ',', absl::SkipEmpty());
    const bool v2 = controllers.empty();
    if (!v2 && std::count(controllers.begin(), controllers.end(), controller) == 0) continue;
    const std::string top = v2 ? root : absl::StrCat(root, "/", controller);
    absl::string_view at = fields[2] == "/" ? "" : fields[2];
    while (true) {
      folders.push_back(absl::StrCat(top, at));
      const size_t slash = at.rfind('/');
      if (slash == absl::string_view::npos) break;
      at = at.substr(0, slash);
    }
  }
  return folders;
}

// The number in a file; nullopt: no file, or no number.
std::optional<int64_t> ReadNumber(const std::string& path) {
  int64_t number = 0;
  const absl::StatusOr<std::string> text = ReadFile(path);
  if (!text.ok() || !absl::SimpleAtoi(absl::StripAsciiWhitespace(*text), &number)) return std::nullopt;
  return number;
}

// The bytes of files that the kernel can drop at once, from a group's memory.stat.
int64_t CachedBytes(const std::string& folder) {
  int64_t own = 0;
  int64_t total = 0;  // with the groups below; only version 1 has it
  const std::string text = ReadFile(folder + "/memory.stat").value_or("");
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    if (absl::ConsumePrefix(&line, "inactive_file ")) (void)absl::SimpleAtoi(line, &own);
    if (absl::ConsumePrefix(&line, "total_inactive_file ")) (void)absl::SimpleAtoi(line, &total);
  }
  return std::max(own, total);
}

std::optional<MemoryLimit> MemoryLimitOf(const std::string& folder) {
  const bool v2 = PathExists(folder + "/memory.max");
  const std::optional<int64_t> limit = ReadNumber(folder + (v2 ? "/memory.max" : "/memory.limit_in_bytes"));
  if (!limit.has_value() || *limit <= 0 || *limit >= kNoLimit) return std::nullopt;
  const int64_t used = ReadNumber(folder + (v2 ? "/memory.current" : "/memory.usage_in_bytes")).value_or(0);
  return MemoryLimit{*limit, std::clamp<int64_t>(*limit - used + CachedBytes(folder), 0, *limit)};
}

// The number of CPUs in a `cpu.max` ("150000 100000" is 1.5); nullopt: "max" (no limit), or malformed text.
std::optional<double> ParseCpuMax(absl::string_view text) {
  const std::vector<absl::string_view> words = absl::StrSplit(text, absl::ByAnyChar(" \n"), absl::SkipEmpty());
  double quota = 0;
  double period = 0;
  if (words.size() != 2 || !absl::SimpleAtod(words[0], &quota) || !absl::SimpleAtod(words[1], &period)) {
    return std::nullopt;
  }
  if (!(quota > 0 && period > 0)) return std::nullopt;
  return quota / period;
}

// The limit of one cgroup folder: v2's file, else v1's two.
std::optional<double> CpuLimitOf(const std::string& folder) {
  if (const std::string v2 = ReadFile(folder + "/cpu.max").value_or(""); !v2.empty()) return ParseCpuMax(v2);
  return ParseCpuMax(absl::StrCat(ReadFile(folder + "/cpu.cfs_quota_us").value_or(""), " ",
                                  ReadFile(folder + "/cpu.cfs_period_us").value_or("")));
}

}  // namespace

std::optional<MemoryLimit> CgroupMemoryLimit(absl::string_view own_cgroups, const std::string& root) {
  std::optional<MemoryLimit> tightest;
  for (const std::string& folder : CgroupFolders(own_cgroups, "memory", root)) {
    const std::optional<MemoryLimit> found = MemoryLimitOf(folder);
    if (!found.has_value()) continue;
    const MemoryLimit other = tightest.value_or(*found);
    tightest = {std::min(found->limit, other.limit), std::min(found->left, other.left)};
  }
  return tightest;
}

std::optional<MemoryLimit> OwnMemoryLimit() {
  return CgroupMemoryLimit(ReadFile("/proc/self/cgroup").value_or(""), "/sys/fs/cgroup");
}

std::optional<double> OwnCpuLimit(absl::string_view own_cgroups, const std::string& root) {
  std::optional<double> tightest;
  for (const std::string& folder : CgroupFolders(own_cgroups, "cpu", root)) {
    const std::optional<double> limit = CpuLimitOf(folder);
    if (limit.has_value()) tightest = std::min(*limit, tightest.value_or(*limit));
  }
  return tightest;
}

int DefaultThreads() {
  cpu_set_t mask;
  const double cpus = sched_getaffinity(0, sizeof(mask), &mask) == 0 ? CPU_COUNT(&mask) : 1;
  const double limit = OwnCpuLimit(ReadFile("/proc/self/cgroup").value_or(""), "/sys/fs/cgroup").value_or(cpus);
  return std::max(1, static_cast<int>(std::min(cpus, limit)));
}

}  // namespace craftfleet
