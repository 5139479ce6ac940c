#include "common/telemetry/process_usage.h"

#include <sys/resource.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <system_error>

namespace craftfleet {

namespace {

int64_t CountOpenFiles() {
  std::error_code error;
  const std::filesystem::directory_iterator files("/proc/self/fd", error);
  return error ? 0 : std::distance(begin(files), end(files)) - 1;  // without the descriptor of this listing
}

}  // namespace

ProcessUsage ReadProcessUsage() {
  ProcessUsage usage;
  rusage times = {};
  if (getrusage(RUSAGE_SELF, &times) == 0) {
    usage.cpu_seconds = static_cast<double>(times.ru_utime.tv_sec + times.ru_stime.tv_sec) +
                        1e-6 * static_cast<double>(times.ru_utime.tv_usec + times.ru_stime.tv_usec);
  }
  usage.open_files = CountOpenFiles();
  return usage;
}

int64_t FilesLeft() {
  rlimit limit = {};
  getrlimit(RLIMIT_NOFILE, &limit);
  return static_cast<int64_t>(limit.rlim_cur) - CountOpenFiles();
}

int64_t ResidentMemoryBytes() {
  int64_t size_pages = 0;
  int64_t resident_pages = 0;
  if (!(std::ifstream("/proc/self/statm") >> size_pages >> resident_pages)) return 0;
  return resident_pages * sysconf(_SC_PAGESIZE);
}

}  // namespace craftfleet
