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
#include "common/wire/wire_flags.h"
#include "craftfleet/v1/admin.grpc.pb.h"
#include "deploy/cli/command.h"

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
  craftfleet admin --address=127.0.0.1:50051 drain NAME    give an actor, or an environment server that registered with
                                                           --learner, no more work, so that it can be stopped; its name
                                                           or address is in craftfleet status
  craftfleet admin --address=127.0.0.1:50051 undrain NAME  give a drained worker work again
  craftfleet admin --address=127.0.0.1:50051 stop          stop the learner, with a checkpoint; --resume continues the run

If the learner has an --access_file, the client needs the right STEER.)";

template <typename Request, typename Reply>
absl::StatusOr<Reply> Call(const wire::Endpoint& learner,
                           grpc::Status (v1::AdminService::Stub::*method)(grpc::ClientContext*, const Request&, Reply*),
                           const Request& request) {
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::GetFlag(FLAGS_timeout).value);
  Reply reply;
  const grpc::Status status = (v1::AdminService::NewStub(learner.channel).get()->*method)(&context, request, &reply);
  if (!status.ok()) return wire::FromCall(status, absl::StrCat("learner ", learner.address), learner);
  return reply;
}

// A call about one worker. Returns its role and name, with a blank.
template <typename Request, typename Reply>
absl::StatusOr<std::string> CallAbout(const std::string& worker, const wire::Endpoint& learner,
                                      grpc::Status (v1::AdminService::Stub::*method)(grpc::ClientContext*,
                                                                                     const Request&, Reply*)) {
  Request request;
  request.set_worker(worker);
  CRAFTFLEET_ASSIGN_OR_RETURN(const Reply reply, Call(learner, method, request));
  return absl::StrCat(Printable(reply.role().substr(0, 80)), " ", worker, " ");
}

// Carries out the command; returns the text to print.
absl::StatusOr<std::string> Do(const std::vector<std::string>& command, const wire::Endpoint& learner) {
  using Stub = v1::AdminService::Stub;
  const std::string& verb = command[0];
  if (verb == "checkpoint") {
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto reply, Call(learner, &Stub::Checkpoint, v1::CheckpointRequest()));
    return absl::StrCat("checkpoint of iteration ", reply.iteration());
  }
  if (verb == "pause") {
    CRAFTFLEET_RETURN_IF_ERROR(Call(learner, &Stub::Pause, v1::PauseRequest()).status());
    return "paused";
  }
  if (verb == "resume") {
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto reply, Call(learner, &Stub::Resume, v1::ResumeRequest()));
    return reply.was_paused() ? "resumed" : "the run was not paused";
  }
  if (verb == "drain") {
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string worker, CallAbout(command[1], learner, &Stub::Drain));
    return worker + "is drained; you can stop it now";
  }
  if (verb == "undrain") {
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string worker, CallAbout(command[1], learner, &Stub::Undrain));
    return worker + "gets work again";
  }
  CRAFTFLEET_RETURN_IF_ERROR(Call(learner, &Stub::Stop, v1::StopRequest()).status());
  return "the learner is stopping";
}

absl::Status CheckCommand(const std::vector<std::string>& command) {
  constexpr absl::string_view kAll = "checkpoint, pause, resume, drain NAME, undrain NAME or stop";
  if (command.empty()) return absl::InvalidArgumentError(absl::StrCat("name a command: ", kAll));
  const std::string& verb = command[0];
  const std::vector<std::string> verbs = {"checkpoint", "pause", "resume", "drain", "undrain", "stop"};
  if (std::find(verbs.begin(), verbs.end(), verb) == verbs.end()) {
    return absl::InvalidArgumentError(
        absl::StrCat("\"", verb, "\" is not a command", DidYouMean(verb, verbs), ", want ", kAll));
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
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::Endpoint learner,
                              wire::ConnectToProcess("learner", absl::GetFlag(FLAGS_address)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string done, Do(command, learner));
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
