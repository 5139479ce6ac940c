// craftfleet admin: steers a run.

#include <cstdio>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/admin.grpc.pb.h"
#include "deploy/status_client.h"

ABSL_FLAG(std::string, address, "127.0.0.1:50051", "address of the learner, HOST:PORT");
ABSL_FLAG(absl::Duration, timeout, absl::Seconds(60),
          "how long to wait until it is done: a checkpoint is written after the update under way, a pause\n"
          "or a worker's end comes after the fragments that are being played");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet admin";
constexpr char kUsage[] =
    R"(craftfleet admin steers a run that goes on. What it comes to stays the same; results differ in nothing.

  craftfleet admin --address=127.0.0.1:50051 checkpoint    write a checkpoint now
  craftfleet admin --address=127.0.0.1:50051 pause         nobody plays, until
  craftfleet admin --address=127.0.0.1:50051 resume
  craftfleet admin --address=127.0.0.1:50051 drain NAME    take an actor or an environment server out, before it is stopped;
                                                           NAME or address as craftfleet status shows them
  craftfleet admin --address=127.0.0.1:50051 stop          end the learner, with a checkpoint; go on with --resume

Where the learner has an --access_file, this needs the right to STEER.)";

// Makes one call, with the program's deadline.
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

// What to print when it is done.
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
    return reply.was_paused() ? "play goes on" : "it was not paused";
  }
  if (verb == "drain") {
    v1::DrainRequest request;
    request.set_worker(command[1]);
    CRAFTFLEET_ASSIGN_OR_RETURN(const v1::DrainReply reply, admin->Call(&Stub::Drain, request));
    return absl::StrCat(reply.role(), " ", command[1], " is drained: it may be stopped");
  }
  CRAFTFLEET_RETURN_IF_ERROR(admin->Call(&Stub::Stop, v1::StopRequest()).status());
  return "the learner stops";
}

absl::Status CheckCommand(const std::vector<std::string>& command) {
  const std::string verb = command.empty() ? "" : command[0];
  const bool known = verb == "checkpoint" || verb == "pause" || verb == "resume" || verb == "drain" || verb == "stop";
  if (!known) {
    return absl::InvalidArgumentError(
        absl::StrFormat("\"%s\" is no command, want checkpoint, pause, resume, drain NAME or stop", verb));
  }
  if (command.size() != (verb == "drain" ? 2 : 1)) {
    return absl::InvalidArgumentError(verb == "drain"
                                          ? "drain wants the name of one worker, as craftfleet status shows it"
                                          : absl::StrCat(verb, " takes no argument"));
  }
  return absl::OkStatus();
}

absl::Status Run(const std::vector<std::string>& command) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCommand(command));
  const absl::Duration timeout = absl::GetFlag(FLAGS_timeout);
  if (timeout <= absl::ZeroDuration() || timeout > absl::Hours(24)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--timeout=%s, want more than 0, at most 24h", absl::FormatDuration(timeout)));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::Endpoint learner, ConnectToProcess("learner", absl::GetFlag(FLAGS_address)));
  Admin admin(learner, timeout);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string done, Do(command, &admin));
  std::puts(done.c_str());
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const std::vector<std::string> command =
      craftfleet::ParseFlagsAndArguments(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run(command));
}
