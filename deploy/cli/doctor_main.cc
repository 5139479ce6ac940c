// craftfleet doctor: checks this machine.

#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>

#include "common/base/status_macros.h"
#include "common/process/program.h"
#include "common/wire/channel.h"
#include "common/wire/channel_flags.h"
#include "deploy/cli/doctor/checks.h"
#include "deploy/cli/doctor/doctor_text.h"
#include "deploy/cli/doctor/machine.h"

ABSL_FLAG(std::string, logdir, "runs", "folder of runs, whose disk is checked for free space and speed");
ABSL_FLAG(std::vector<std::string>, listen, {"127.0.0.1:50051"},
          "addresses to check for a free port, HOST:PORT, joined by commas");
ABSL_FLAG(bool, json, false, "print JSON");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet doctor";
constexpr char kUsage[] =
    R"(craftfleet doctor checks whether this machine is ready for training, and suggests what to change.

  craftfleet doctor
  craftfleet doctor --logdir=/data/runs --listen=0.0.0.0:50051,0.0.0.0:50061
  craftfleet doctor --tls_ca=certs/ca.pem --tls_cert=certs/learner.pem --tls_key=certs/learner.key
  craftfleet doctor --json

It checks the CPU, the BLAS, memory, open files, the disk, the clock, shared memory, GPUs, ports and TLS files, and lists
versions. The exit code is 1 if a check fails, and 0 if there are only warnings. On a terminal the output has colours, unless
NO_COLOR is set.)";

std::vector<Finding> CheckMachine() {
  const DiskFacts disk = MeasureDisk(absl::GetFlag(FLAGS_logdir));
  std::vector<Finding> findings = {CheckCpuFeatures(ReadCpu()),
                                   CheckBlas(ReadBlas()),
                                   CheckMemory(ReadAvailableMemory()),
                                   CheckOpenFiles(ReadOpenFilesLimit()),
                                   CheckDiskSpace(disk),
                                   CheckDiskSync(disk),
                                   CheckClock(ReadClock()),
                                   CheckSharedMemory(ReadSharedMemory()),
                                   CheckGpu(ReadGpu())};
  for (const std::string& address : absl::GetFlag(FLAGS_listen)) {
    if (absl::StartsWith(address, "unix:")) continue;  // a program replaces the socket when it starts to listen
    findings.push_back(CheckPort(address, TryPort(address)));
  }
  const wire::TlsFiles files = wire::TlsFilesFromFlags();
  if (!files.certificate.empty() || !files.key.empty() || !files.authorities.empty()) {
    findings.push_back(CheckTls({files.certificate, files.key, files.authorities, absl::Now()}));
  }
  findings.push_back(ListVersions(ReadVersions()));
  return findings;
}

absl::Status Run() {
  for (const std::string& address : absl::GetFlag(FLAGS_listen)) {
    CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("listen", address));
  }
  const std::vector<Finding> findings = CheckMachine();
  if (absl::GetFlag(FLAGS_json)) {
    std::fputs(DoctorJson(findings).c_str(), stdout);
  } else {
    const bool colour = WantsColour(isatty(STDOUT_FILENO) == 1, std::getenv("NO_COLOR"), std::getenv("TERM"));
    std::fputs(DoctorText(findings, colour).c_str(), stdout);
  }
  const std::string failed = FailedChecks(findings);
  if (failed.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("failed checks: ", failed));
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv, {"logdir", "listen", "json"});
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
