// craftfleet status: prints the status of a process of the fleet.

#include <cstdio>
#include <string>

#include <absl/flags/flag.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "common/base/status_macros.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/wire/channel.h"
#include "common/wire/status_service.h"
#include "common/wire/wire_flags.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "deploy/cli/command.h"
#include "deploy/cli/status_text.h"

ABSL_FLAG(bool, watch, false, "print the status repeatedly, until stopped");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet status";
constexpr char kUsage[] =
    R"(craftfleet status prints the status of any process of the fleet: role, version, run, uptime, rates, counts, peers.

  craftfleet status --address=127.0.0.1:50051
  craftfleet status --address=127.0.0.1:50051 --json
  craftfleet status --address=127.0.0.1:50051 --watch --interval=5s

The status of a learner covers the whole fleet; craftfleet top shows it as a live page.)";

// Errors name the address.
absl::StatusOr<v1::StatusReply> AskStatus(const wire::Endpoint& process, absl::Duration timeout) {
  grpc::ClientContext context;
  wire::SetDeadline(&context, timeout);
  v1::StatusReply reply;
  const grpc::Status status = v1::StatusService::NewStub(process.channel)->GetStatus(&context, {}, &reply);
  if (!status.ok()) return wire::FromCall(status, process.address, process);
  return reply;
}

absl::Status Print(const v1::StatusReply& reply) {
  std::string text;
  if (absl::GetFlag(FLAGS_json)) {
    CRAFTFLEET_ASSIGN_OR_RETURN(text, wire::StatusJson(reply, /*whitespace=*/true));
  } else {
    text = StatusText(reply);
  }
  std::fputs(text.c_str(), stdout);
  std::fflush(stdout);
  return absl::OkStatus();
}

// Prints the status again and again, until the process ends or standard output is closed.
absl::Status Watch(const wire::Endpoint& process, absl::Duration interval) {
  while (true) {
    const absl::StatusOr<v1::StatusReply> reply = AskStatus(process, absl::Seconds(10));
    if (absl::IsUnavailable(reply.status())) {
      return absl::UnavailableError(absl::StrCat(process.address, ": it has stopped, or cannot be reached"));
    }
    CRAFTFLEET_RETURN_IF_ERROR(reply.status());
    CRAFTFLEET_RETURN_IF_ERROR(Print(*reply));
    std::puts("");
    std::fflush(stdout);
    if (std::ferror(stdout) != 0) return absl::OkStatus();  // ExitCode prints the reason
    absl::SleepFor(interval);
  }
}

absl::Status Run() {
  const absl::Duration interval = absl::GetFlag(FLAGS_interval).value;
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("interval", interval, absl::Milliseconds(100), absl::Minutes(1)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::Endpoint process,
                              wire::ConnectToProcess("process", absl::GetFlag(FLAGS_address)));
  if (absl::GetFlag(FLAGS_watch)) return Watch(process, interval);
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::StatusReply reply, AskStatus(process, absl::Seconds(2)));
  return Print(reply);
}

int RunStatus(int argc, char** argv) {
  ParseFlags({kProgram,
              kUsage,
              {"address", "json", "watch", "interval"},
              {"channel_flags.cc"},
              {{"address", "address of a learner, actor or environment server, HOST:PORT"},
               {"interval", "with --watch: time between updates, 100ms..1m; a plain number is in seconds"}}},
             argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("status", &RunStatus);

}  // namespace
}  // namespace craftfleet
