// craftfleet admin: steers a run.

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/process/closest_name.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/admin.grpc.pb.h"
#include "deploy/cli/command.h"
#include "deploy/cli/status_client.h"

ABSL_FLAG(craftfleet::TimeSpan, timeout, {absl::Minutes(1)},
          "how long to wait for the command to finish, at most 24h; a plain number is in seconds\n"
          "A checkpoint is written after the current update. Pause and drain wait for the fragments being played");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet admin";
constexpr char kUsage[] =
    R"(craftfleet admin COMMAND steers a run in progress. None of its commands changes the result of the run.

  craftfleet admin --address=127.0.0.1:50051 checkpoint    write a checkpoint now
  craftfleet admin --address=127.0.0.1:50051 pause         stop playing
  craftfleet admin --address=127.0.0.1:50051 resume        continue playing after a pause
  craftfleet admin --address=127.0.0.1:50051 drain NAME    give an actor or an environment server no more work, so that
                                                           it can be stopped; its name or address is in craftfleet status
  craftfleet admin --address=127.0.0.1:50051 undrain NAME  give a drained worker work again
  craftfleet admin --address=127.0.0.1:50051 stop          stop the learner, with a checkpoint; --resume continues the run

If the learner has an --access_file, the client needs the right STEER.)";

// Makes calls with the program's deadline.
class Admin {
 public:
  Admin(const wire::Endpoint& learner, absl::Duration timeout)
      : learner_(learner), timeout_(timeout), stub_(v1::AdminService::NewStub(learner.channel)) {}

  template <typename Request, typename Reply>
  absl::StatusOr<Reply> Call(grpc::Status (v1::AdminService::Stub::*method)(grpc::ClientContext*, const Request&,
                                                                            Reply*),
                             const Request& request) {
    grpc::ClientContext context;
    wire::SetDeadline(&context, timeout_);
    Reply reply;
    const grpc::Status status = (stub_.get()->*method)(&context, request, &reply);
    if (!status.ok()) return wire::FromCall(status, absl::StrCat("learner ", learner_.address), learner_);
    return reply;
  }

 private:
  const wire::Endpoint learner_;
  const absl::Duration timeout_;
  const std::unique_ptr<v1::AdminService::Stub> stub_;
};

// Carries out the command; returns the text to print.
absl::StatusOr<std::string> Do(const std::vector<std::string>& command, Admin* admin) {
  using Stub = v1::AdminService::Stub;
  const std::string& verb = command[0];
  if (verb == "checkpoint") {
    CRAFTFLEET_ASSIGN_OR_RETURN(const v1::CheckpointReply reply,
                                admin->Call(&Stub::Checkpoint, v1::CheckpointRequest()));
    return absl::StrCat("checkpoint of iteration ", reply.iteration());
  }
  if (verb == "pause") {
    CRAFTFLEET_RETURN_IF_ERROR(admin->Call(&Stub::Pause, v1::PauseRequest()).status());
    return "paused";
  }
  if (verb == "resume") {
    CRAFTFLEET_ASSIGN_OR_RETURN(const v1::ResumeReply reply, admin->Call(&Stub::Resume, v1::ResumeRequest()));
    return reply.was_paused() ? "resumed" : "the run was not paused";
  }
  if (verb == "drain") {
    v1::DrainRequest request;
    request.set_worker(command[1]);
    CRAFTFLEET_ASSIGN_OR_RETURN(const v1::DrainReply reply, admin->Call(&Stub::Drain, request));
    return absl::StrCat(Printable(reply.role().substr(0, 80)), " ", command[1], " is drained; you can stop it now");
  }
  if (verb == "undrain") {
    v1::UndrainRequest request;
    request.set_worker(command[1]);
    CRAFTFLEET_ASSIGN_OR_RETURN(const v1::UndrainReply reply, admin->Call(&Stub::Undrain, request));
    return absl::StrCat(Printable(reply.role().substr(0, 80)), " ", command[1], " gets work again");
  }
  CRAFTFLEET_RETURN_IF_ERROR(admin->Call(&Stub::Stop, v1::StopRequest()).status());
  return "the learner is stopping";
}

absl::Status CheckCommand(const std::vector<std::string>& command) {
  constexpr absl::string_view kAll = "checkpoint, pause, resume, drain NAME, undrain NAME or stop";
  if (command.empty()) return absl::InvalidArgumentError(absl::StrCat("name a command: ", kAll));
  const std::string& verb = command[0];
  const std::vector<std::string> verbs = {"checkpoint", "pause", "resume", "drain", "undrain", "stop"};
  if (std::find(verbs.begin(), verbs.end(), verb) == verbs.end()) {
    const std::string closest = ClosestName(verb, verbs);
    return absl::InvalidArgumentError(
        absl::StrCat("\"", verb, "\" is not a command",
                     closest.empty() ? "" : absl::StrCat(" (did you mean \"", closest, "\"?)"), ", want ", kAll));
  }
  const bool of_worker = verb == "drain" || verb == "undrain";
  if (command.size() != (of_worker ? 2 : 1)) {
    return absl::InvalidArgumentError(absl::StrCat(
        verb, of_worker ? " needs the name of one worker, as craftfleet status shows it" : " takes no argument"));
  }
  return absl::OkStatus();
}

absl::Status Run(const std::vector<std::string>& command) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCommand(command));
  const absl::Duration timeout = absl::GetFlag(FLAGS_timeout).value;
  if (timeout <= absl::ZeroDuration() || timeout > absl::Hours(24)) {
    return InvalidFlag("timeout", absl::FormatDuration(timeout), "more than 0, at most 24h");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::Endpoint learner, ConnectToProcess("learner", absl::GetFlag(FLAGS_address)));
  Admin admin(learner, timeout);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string done, Do(command, &admin));
  std::puts(done.c_str());
  return absl::OkStatus();
}

int RunAdmin(int argc, char** argv) {
  const std::vector<std::string> command =
      ParseFlagsAndArguments({kProgram, kUsage, {"address", "timeout"}, {"channel_flags.cc"}}, argc, argv);
  return ExitCode(kProgram, Run(command));
}

const RegisterCommand kRegistered("admin", &RunAdmin);

}  // namespace
}  // namespace craftfleet
