// craftfleet doctor: checks this machine.

#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>

#include "common/base/status_macros.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/wire/channel.h"
#include "common/wire/channel_flags.h"
#include "deploy/cli/command.h"
#include "deploy/cli/doctor/checks.h"
#include "deploy/cli/doctor/doctor_text.h"
#include "deploy/cli/doctor/machine.h"

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

std::vector<Finding> CheckMachine(const std::vector<std::string>& addresses) {
  const std::string logdir = absl::GetFlag(FLAGS_logdir);
  const DiskFacts disk = MeasureDisk(logdir.empty() ? "runs" : logdir);
  std::vector<Finding> findings = {CheckCpuFeatures(ReadCpu()),
                                   CheckBlas(ReadBlas()),
                                   CheckMemory(ReadAvailableMemory()),
                                   CheckOpenFiles(ReadOpenFilesLimit()),
                                   CheckDiskSpace(disk),
                                   CheckDiskSync(disk),
                                   CheckClock(ReadClock()),
                                   CheckSharedMemory(ReadSharedMemory()),
                                   CheckGpu(ReadGpu())};
  for (const std::string& address : addresses) {
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
  const std::vector<std::string> addresses =
      absl::StrSplit(absl::GetFlag(FLAGS_listen).address.value_or(kLearnerAddress), ',', absl::SkipEmpty());
  for (const std::string& address : addresses) {
    CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("listen", address));
  }
  const std::vector<Finding> findings = CheckMachine(addresses);
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

int RunDoctor(int argc, char** argv) {
  ParseFlags({kProgram,
              kUsage,
              {"logdir", "listen", "json"},
              {"channel_flags.cc"},
              {{"logdir", "folder of runs, whose disk is checked for free space and speed [runs]"},
               {"listen", "addresses to check for a free port, HOST:PORT, joined by commas [127.0.0.1:50051]"}}},
             argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("doctor", &RunDoctor);

}  // namespace
}  // namespace craftfleet
