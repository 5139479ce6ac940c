#include "deploy/cli/doctor/machine.h"

#include <openssl/crypto.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/timex.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <memory>
#include <optional>

#include <ATen/Context.h>
#include <absl/cleanup/cleanup.h>
#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>
#include <absl/time/clock.h>
#include <google/protobuf/stubs/common.h>
#include <grpcpp/grpcpp.h>
#include <torch/version.h>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/process/cgroup.h"
#include "common/process/cpu_pin.h"
#include "common/process/cpu_quota.h"
#include "common/process/version.h"
#include "common/telemetry/gpu_usage.h"
#include "common/wire/listen_socket.h"

namespace craftfleet {
namespace {

std::string TextOf(const std::string& path) { return ReadFile(path).value_or(""); }

std::string Maps() { return TextOf("/proc/self/maps"); }

absl::string_view BaseName(absl::string_view path) { return path.substr(path.rfind('/') + 1); }

// `path` if it is a folder, otherwise the nearest folder above it.
std::string ExistingFolder(std::string path) {
  while (!path.empty() && !PathExists(path)) {
    const size_t slash = path.rfind('/');
    if (slash == std::string::npos) return ".";
    path.resize(slash);
  }
  return path.empty() ? "/" : path;
}

absl::StatusOr<int64_t> FreeSpace(const std::string& folder) {
  struct statvfs disk = {};
  if (statvfs(folder.c_str(), &disk) != 0) return FileError(errno, "look at", folder);
  return static_cast<int64_t>(disk.f_bavail) * static_cast<int64_t>(disk.f_frsize);
}

absl::StatusOr<absl::Duration> SyncTime(const std::string& folder) {
  const std::string path = JoinPath(folder, absl::StrCat(".craftfleet-doctor-", getpid()));
  const auto remove = absl::MakeCleanup([&path] { RemoveAll(path).IgnoreError(); });
  const std::string bytes(1 << 20, 'x');
  std::array<absl::Duration, 5> times;
  for (absl::Duration& time : times) {
    const absl::Time start = absl::Now();
    CRAFTFLEET_RETURN_IF_ERROR(WriteFileSynced(path, bytes));
    time = absl::Now() - start;
  }
  std::sort(times.begin(), times.end());
  return times[times.size() / 2];
}

}  // namespace

std::string MappedFile(absl::string_view maps, const std::vector<absl::string_view>& names) {
  for (const absl::string_view line : absl::StrSplit(maps, '\n')) {
    const size_t slash = line.find('/');
    if (slash == absl::string_view::npos) continue;
    const absl::string_view path = line.substr(slash);
    const bool wanted = std::any_of(names.begin(), names.end(),
                                    [path](absl::string_view name) { return absl::StrContains(BaseName(path), name); });
    if (wanted) return std::string(path);
  }
  return "";
}

CpuFacts ReadCpu() {
  return {CpuDescription(), CheckCpu(v1::RunConfig::AVX2).ok(), CheckCpu(v1::RunConfig::AVX512).ok(), DefaultThreads()};
}

BlasFacts ReadBlas() {
  return {MappedFile(Maps(), {"libopenblas", "libblas", "libmkl", "libblis", "libatlas"}), SlowMathWarning()};
}

int64_t AvailableMemory(absl::string_view meminfo) {
  for (absl::string_view line : absl::StrSplit(meminfo, '\n')) {
    int64_t kib = 0;
    if (absl::ConsumePrefix(&line, "MemAvailable:") && absl::ConsumeSuffix(&line, "kB") &&
        absl::SimpleAtoi(line, &kib)) {
      return kib * 1024;
    }
  }
  return 0;
}

int64_t ReadAvailableMemory() {
  const int64_t available = AvailableMemory(TextOf("/proc/meminfo"));
  const std::optional<MemoryLimit> limit = OwnMemoryLimit();
  if (!limit.has_value()) return available;
  return available == 0 ? limit->left : std::min(available, limit->left);
}

uint64_t ReadOpenFilesLimit() {
  rlimit limit = {};
  return getrlimit(RLIMIT_NOFILE, &limit) == 0 ? limit.rlim_max : 0;
}

DiskFacts MeasureDisk(const std::string& logdir) {
  const std::string folder = ExistingFolder(logdir);
  return {folder, FreeSpace(folder), SyncTime(folder)};
}

ClockFacts ReadClock() {
  ClockFacts facts;
  facts.now = absl::Now();
  struct stat own = {};
  facts.program_built = stat("/proc/self/exe", &own) == 0 ? absl::FromTimeT(own.st_mtime) : absl::InfinitePast();
  timex kernel = {};
  const int state = adjtimex(&kernel);
  if (state >= 0) facts.synchronized = state != TIME_ERROR && (kernel.status & STA_UNSYNC) == 0;
  return facts;
}

std::optional<int64_t> ReadSharedMemory() {
  struct statvfs shm = {};
  if (statvfs("/dev/shm", &shm) != 0) return std::nullopt;
  return static_cast<int64_t>(shm.f_blocks) * static_cast<int64_t>(shm.f_frsize);
}

GpuFacts ReadGpu() {
  GpuFacts facts;
  const std::unique_ptr<Nvml> driver = Nvml::Open();
  for (int i = 0; PathExists(absl::StrCat("/dev/nvidia", i)); ++i) {
    const std::string number = absl::StrCat(i);
    facts.devices.push_back(DescribeGpu("/dev/nvidia" + number, driver == nullptr ? std::nullopt : driver->Read(number),
                                        driver == nullptr ? std::nullopt : driver->ComputeCapability(number)));
  }
  facts.libtorch_has_cuda = !MappedFile(Maps(), {"libtorch_cuda"}).empty();
  facts.usable = static_cast<int>(at::getNumGPUs());
  return facts;
}

absl::Status TryPort(const std::string& address) { return wire::ListenSocket::Create(address).status(); }

std::vector<std::pair<std::string, std::string>> ReadVersions() {
  utsname kernel = {};
  uname(&kernel);
  return {{"CraftFleet", BuildId()},
          {"LibTorch", TORCH_VERSION},
          {"gRPC", grpc::Version()},
          {"Protobuf", google::protobuf::internal::VersionString(GOOGLE_PROTOBUF_VERSION)},
          {"OpenSSL", OpenSSL_version(OPENSSL_VERSION_STRING)},
          {kernel.sysname, kernel.release}};
}

}  // namespace craftfleet
