// craftfleet doctor: checks this machine.

#include <fcntl.h>
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
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <ATen/Context.h>
#include <absl/cleanup/cleanup.h>
#include <absl/flags/flag.h>
#include <absl/status/status.h>
#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>
#include <absl/strings/strip.h>
#include <absl/time/clock.h>
#include <google/protobuf/stubs/common.h>
#include <grpcpp/grpcpp.h>
#include <nlohmann/json.hpp>
#include <torch/version.h>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/process/cgroup.h"
#include "common/process/cpu_pin.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/process/version.h"
#include "common/telemetry/gpu_usage.h"
#include "common/wire/channel.h"
#include "common/wire/listen_socket.h"
#include "common/wire/wire_flags.h"
#include "deploy/cli/command.h"
#include "deploy/cli/doctor_checks.h"

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet doctor";
constexpr char kUsage[] =
    R"(craftfleet doctor checks whether this machine is ready for training, and suggests what to change.

  craftfleet doctor
  craftfleet doctor --logdir=/data/runs --listen=0.0.0.0:50051,0.0.0.0:50061
  craftfleet doctor --tls_ca=certs/ca.pem --tls_cert=certs/learner.pem --tls_key=certs/learner.key
  craftfleet doctor --json

It checks the CPU, the BLAS, memory, open files, the disk, the clock, GPUs, ports and TLS files, and lists
versions. The exit code is 1 if a check fails, and 0 if there are only warnings. On a terminal the output has colours, unless
NO_COLOR is set.)";

std::string TextOf(const std::string& path) { return ReadFile(path).value_or(""); }

absl::string_view BaseName(absl::string_view path) { return path.substr(path.rfind('/') + 1); }

// `path` if it exists, otherwise the nearest folder above it.
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

// How long it takes to write 1 MiB into `folder` and to sync it: the median of a few files, which are removed.
absl::StatusOr<absl::Duration> SyncTime(const std::string& folder) {
  const std::string path = JoinPath(folder, absl::StrCat(".craftfleet-doctor-", getpid()));
  const std::string bytes(1 << 20, 'x');
  std::array<absl::Duration, 5> times;
  for (absl::Duration& time : times) {
    const absl::Time start = absl::Now();
    const int file = open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    if (file < 0) return FileError(errno, "cannot create", path);
    const absl::Cleanup close_file = [file] { close(file); };
    unlink(path.c_str());  // at once: nothing stays when a signal ends this program
    CRAFTFLEET_RETURN_IF_ERROR(WriteAll(file, bytes, path));
    if (SyncDescriptor(file) != 0) return FileError(errno, "cannot sync", path);
    time = absl::Now() - start;
  }
  std::sort(times.begin(), times.end());
  return times[times.size() / 2];
}

// The first mapped file of this process whose name contains one of `names`; empty if there is none.
std::string MappedFile(const std::vector<absl::string_view>& names) {
  const std::string maps = TextOf("/proc/self/maps");
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

std::string FindBlas() {
  // A LibTorch with MKL calls no other BLAS: the one that is mapped in the wheel is OpenCV's.
  if (at::hasMKL()) return MappedFile({"libmkl"});
  return MappedFile({"libopenblas", "libblas", "libblis", "libatlas"});
}

// Bytes; 0: unknown.
int64_t AvailableMemory() {
  const std::string meminfo = TextOf("/proc/meminfo");
  for (absl::string_view line : absl::StrSplit(meminfo, '\n')) {
    int64_t kib = 0;
    if (absl::ConsumePrefix(&line, "MemAvailable:") && absl::ConsumeSuffix(&line, "kB") &&
        absl::SimpleAtoi(line, &kib)) {
      return kib * 1024;
    }
  }
  return 0;
}

// The lesser of that and of what this process' cgroups leave.
int64_t ReadAvailableMemory() {
  const int64_t available = AvailableMemory();
  const std::optional<MemoryLimit> limit = OwnMemoryLimit();
  if (!limit.has_value()) return available;
  return available == 0 ? limit->left : std::min(available, limit->left);
}

uint64_t ReadOpenFilesLimit() {
  rlimit limit = {};
  return getrlimit(RLIMIT_NOFILE, &limit) == 0 ? limit.rlim_max : 0;
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

// As the driver counts them, because a container may have /dev/nvidia1 alone, and WSL has no such files.
std::vector<std::string> ReadGpusOfDriver() {
  std::vector<std::string> gpus;
  const std::unique_ptr<Nvml> driver = Nvml::Open();
  while (driver != nullptr) {
    const std::optional<GpuUsage> gpu = driver->Read(absl::StrCat(gpus.size()));
    if (!gpu.has_value()) break;
    gpus.push_back(DescribeGpu(static_cast<int>(gpus.size()), *gpu));
  }
  return gpus;
}

std::vector<std::string> FindGpuFiles() {
  std::vector<std::string> files;
  for (int i = 0; i < 64; ++i) {
    std::string file = absl::StrCat("/dev/nvidia", i);
    if (PathExists(file)) files.push_back(std::move(file));
  }
  return files;
}

GpuFacts ReadGpu() {
  GpuFacts facts;
  facts.devices = ReadGpusOfDriver();
  if (facts.devices.empty()) facts.devices = FindGpuFiles();
  facts.libtorch_has_cuda = !MappedFile({"libtorch_cuda"}).empty();
  facts.usable = static_cast<int>(at::getNumGPUs());
  return facts;
}

// Listens on `address` for a moment.
absl::Status TryPort(const std::string& address) { return wire::ListenSocket::Create(address).status(); }

std::string ReadVersions() {
  utsname kernel = {};
  uname(&kernel);
  return absl::StrCat("CraftFleet ", BuildId(), ", LibTorch ", TORCH_VERSION, ", gRPC ", grpc::Version(), ", Protobuf ",
                      google::protobuf::internal::VersionString(GOOGLE_PROTOBUF_VERSION), ", OpenSSL ",
                      OpenSSL_version(OPENSSL_VERSION_STRING), ", ", kernel.sysname, " ", kernel.release);
}

absl::string_view Name(Verdict verdict) {
  if (verdict == Verdict::kOk) return "ok";
  return verdict == Verdict::kWarn ? "warn" : "FAIL";
}

absl::string_view Color(Verdict verdict) {
  if (verdict == Verdict::kOk) return "\033[32m";
  return verdict == Verdict::kWarn ? "\033[33m" : "\033[1;31m";
}

// A line for each finding, followed by one with the remedy unless it is ok. With `color` the verdicts have colours.
std::string DoctorText(const std::vector<Finding>& findings, bool color) {
  size_t width = 0;
  for (const Finding& finding : findings) width = std::max(width, finding.check.size());
  std::string text;
  for (const Finding& finding : findings) {
    const std::string verdict = absl::StrFormat("%-4s", Name(finding.verdict));
    absl::StrAppendFormat(&text, "%s  %-*s  %s\n",
                          color ? absl::StrCat(Color(finding.verdict), verdict, "\033[0m") : verdict,
                          static_cast<int>(width), finding.check, finding.found);
    if (!finding.remedy.empty()) absl::StrAppendFormat(&text, "      %*s  -> %s\n", width, "", finding.remedy);
  }
  return text;
}

// Names of the failed checks, joined by commas; empty without any.
std::string FailedChecks(const std::vector<Finding>& findings) {
  std::vector<std::string> names;
  for (const Finding& finding : findings) {
    if (finding.verdict == Verdict::kFail) names.push_back(finding.check);
  }
  return absl::StrJoin(names, ", ");
}

// "ok" is false if a check fails.
std::string DoctorJson(const std::vector<Finding>& findings) {
  nlohmann::ordered_json checks = nlohmann::ordered_json::array();
  for (const Finding& finding : findings) {
    checks.push_back({{"check", finding.check},
                      {"verdict", finding.verdict == Verdict::kFail ? "fail" : std::string(Name(finding.verdict))},
                      {"found", finding.found},
                      {"remedy", finding.remedy}});
  }
  const nlohmann::ordered_json json = {{"ok", FailedChecks(findings).empty()}, {"checks", std::move(checks)}};
  return json.dump(2, ' ', /*ensure_ascii=*/false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

// Terminals have colours, unless NO_COLOR has a value (https://no-color.org).
bool WantsColor() {
  const char* const no_color = std::getenv("NO_COLOR");
  const char* const term = std::getenv("TERM");
  const bool refused = no_color != nullptr && *no_color != '\0';
  return isatty(STDOUT_FILENO) == 1 && !refused && term != nullptr && absl::string_view(term) != "dumb";
}

std::vector<Finding> CheckMachine(const std::vector<std::string>& addresses) {
  const std::string logdir = absl::GetFlag(FLAGS_logdir);
  const std::string folder = ExistingFolder(logdir.empty() ? "runs" : logdir);
  std::vector<Finding> findings = {CheckCpuFeatures(CpuDescription(), CheckCpu(v1::RunConfig::AVX2).ok(),
                                                    CheckCpu(v1::RunConfig::AVX512).ok(), DefaultThreads()),
                                   CheckBlas(FindBlas(), SlowMathWarning()),
                                   CheckMemory(ReadAvailableMemory()),
                                   CheckOpenFiles(ReadOpenFilesLimit()),
                                   CheckDiskSpace(folder, FreeSpace(folder)),
                                   CheckDiskSync(folder, SyncTime(folder)),
                                   CheckClock(ReadClock()),
                                   CheckGpu(ReadGpu())};
  for (const std::string& address : addresses) {
    if (absl::StartsWith(address, "unix:")) continue;  // a program replaces the socket when it starts to listen
    findings.push_back(CheckPort(address, TryPort(address)));
  }
  const wire::TlsFiles files = wire::TlsFilesFromFlags();
  if (!files.empty()) findings.push_back(CheckTls(files, absl::Now()));
  findings.push_back({"versions", Verdict::kOk, ReadVersions(), ""});
  return findings;
}

absl::Status Run() {
  const std::vector<std::string> addresses =
      absl::StrSplit(absl::GetFlag(FLAGS_listen).address.value_or(kLearnerAddress), ',', absl::SkipEmpty());
  for (const std::string& address : addresses) {
    CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("listen", address));
  }
  const std::vector<Finding> findings = CheckMachine(addresses);
  if (absl::GetFlag(FLAGS_json)) {
    std::fputs(DoctorJson(findings).c_str(), stdout);
  } else {
    std::fputs(DoctorText(findings, WantsColor()).c_str(), stdout);
  }
  const std::string failed = FailedChecks(findings);
  if (failed.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("failed checks: ", failed));
}

int RunDoctor(int argc, char** argv) {
  ParseFlags({kProgram,
              kUsage,
              {"logdir", "listen", "json"},
              {"tls_ca", "tls_cert", "tls_key"},
              {{"logdir", "folder of runs, whose disk is checked for free space and speed [runs]"},
               {"listen", "addresses to check for a free port, HOST:PORT, joined by commas [127.0.0.1:50051]"}}},
             argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("doctor", &RunDoctor);

}  // namespace
}  // namespace craftfleet
