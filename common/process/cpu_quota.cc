#include "common/process/cpu_quota.h"

#include <sched.h>

#include <algorithm>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>

#include "common/io/files.h"
#include "common/process/cgroup.h"

namespace craftfleet {
namespace {

// The file's text; empty if it can't be read.
std::string ReadText(const std::string& path) { return ReadFile(path).value_or(""); }

// The limit of one cgroup folder: v2's file, else v1's two.
std::optional<double> CpuLimitOf(const std::string& folder) {
  if (const std::string v2 = ReadText(folder + "/cpu.max"); !v2.empty()) return ParseCpuMax(v2);
  return ParseCpuMax(
      absl::StrCat(ReadText(folder + "/cpu.cfs_quota_us"), " ", ReadText(folder + "/cpu.cfs_period_us")));
}

}  // namespace

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
  const double limit = OwnCpuLimit(ReadText("/proc/self/cgroup"), "/sys/fs/cgroup").value_or(cpus);
  return std::max(1, static_cast<int>(std::min(cpus, limit)));
}

}  // namespace craftfleet
