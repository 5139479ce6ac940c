#include "common/process/cpu_quota.h"

#include <sched.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>

namespace craftfleet {
namespace {

// The file's text; empty if it can't be read.
std::string ReadText(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

// The limit of one cgroup folder: v2's file, else v1's two.
std::optional<double> FolderLimit(const std::string& folder) {
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

std::optional<double> CgroupCpuLimit(const std::string& root, const std::string& path) {
  std::optional<double> tightest;
  std::string at = path == "/" ? "" : path;
  while (true) {
    const std::optional<double> limit = FolderLimit(root + at);
    if (limit.has_value()) tightest = std::min(limit.value(), tightest.value_or(*limit));
    const size_t slash = at.rfind('/');
    if (slash == std::string::npos) return tightest;
    at.resize(slash);
  }
}

std::optional<double> OwnCpuLimit(absl::string_view own_cgroups, const std::string& root) {
  std::optional<double> tightest;
  for (const absl::string_view line : absl::StrSplit(own_cgroups, '\n')) {
    const std::vector<std::string> fields = absl::StrSplit(line, absl::MaxSplits(':', 2));
    if (fields.size() != 3) continue;
    const std::vector<std::string> controllers = absl::StrSplit(fields[1], ',', absl::SkipEmpty());
    const bool v2 = controllers.empty();
    if (!v2 && std::count(controllers.begin(), controllers.end(), "cpu") == 0) continue;
    const std::optional<double> limit = CgroupCpuLimit(v2 ? root : root + "/cpu", fields[2]);
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
