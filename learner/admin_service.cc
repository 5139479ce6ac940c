#include "learner/admin_service.h"

#include <algorithm>
#include <chrono>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/log.h"
#include "common/wire/grpc_status.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kTick = absl::Milliseconds(20);
constexpr absl::Duration kLongest = absl::Hours(24);
constexpr absl::Duration kMargin = absl::Milliseconds(50);  // for the answer to arrive in time

// How long the client still waits.
absl::Duration TimeLeft(const grpc::ServerContext& context) {
  const absl::Duration left = absl::FromChrono(context.deadline()) - absl::Now() - kMargin;
  return std::clamp(left, absl::ZeroDuration(), kLongest);
}

}  // namespace

absl::Status AdminServiceImpl::WaitFor(grpc::ServerContext* context, const std::function<bool()>& done,
                                       absl::string_view otherwise) {
  const absl::Time end = SteadyNow() + TimeLeft(*context);
  while (!done()) {
    if (context->IsCancelled()) return absl::CancelledError("the client left");
    if (SteadyNow() > end) return absl::DeadlineExceededError(otherwise);
    absl::SleepFor(kTick);
  }
  return absl::OkStatus();
}

grpc::Status AdminServiceImpl::Checkpoint(grpc::ServerContext* context, const v1::CheckpointRequest* /*request*/,
                                          v1::CheckpointReply* reply) {
  LogInfo("admin %s: checkpoint", context->peer());
  const absl::StatusOr<int64_t> iteration = parts_.checkpoints->Ask(TimeLeft(*context));
  if (!iteration.ok()) return wire::ToGrpc(iteration.status());
  reply->set_iteration(*iteration);
  return grpc::Status::OK;
}

grpc::Status AdminServiceImpl::Pause(grpc::ServerContext* context, const v1::PauseRequest* /*request*/,
                                     v1::PauseReply* /*reply*/) {
  LogInfo("admin %s: pause", context->peer());
  parts_.ledger->SetPaused(true);
  const absl::Status status = WaitFor(
      context, [this] { return parts_.ledger->permits() == 0; }, "paused, but some fragments are still being played");
  if (status.ok()) LogInfo("paused: nothing is played until craftfleet admin resume");
  return wire::ToGrpc(status);
}

grpc::Status AdminServiceImpl::Resume(grpc::ServerContext* context, const v1::ResumeRequest* /*request*/,
                                      v1::ResumeReply* reply) {
  LogInfo("admin %s: resume", context->peer());
  reply->set_was_paused(parts_.ledger->SetPaused(false));
  return grpc::Status::OK;
}

grpc::Status AdminServiceImpl::Drain(grpc::ServerContext* context, const v1::DrainRequest* request,
                                     v1::DrainReply* reply) {
  LogInfo("admin %s: drain %s", context->peer(), request->worker());
  if (request->worker().empty()) {  // which is the address of a worker without one
    return wire::ToGrpc(absl::InvalidArgumentError("worker is empty, want a name or an address"));
  }
  for (const LaneLedger::ActorInfo& actor : parts_.ledger->Actors()) {
    if (actor.name != request->worker() && actor.address != request->worker()) continue;
    reply->set_role("actor");
    return wire::ToGrpc(DrainActor(context, actor.name));
  }
  for (const ServerRegistry::Server& server : parts_.env_servers->All()) {
    if (server.name != request->worker() && server.address != request->worker()) continue;
    reply->set_role("envserver");
    return wire::ToGrpc(DrainServer(context, server.name));
  }
  return wire::ToGrpc(NoSuchWorker(request->worker()));
}

absl::Status AdminServiceImpl::DrainActor(grpc::ServerContext* context, const std::string& actor) {
  parts_.ledger->Drain(actor);
  absl::Status status = WaitFor(
      context, [&] { return parts_.ledger->IsDrained(actor) && !parts_.evaluations->IsPlaying(actor); },
      "it gets nothing more to play, but is not done with what it has");
  if (status.ok()) LogInfo("actor %s is drained", actor);
  return status;
}

absl::Status AdminServiceImpl::DrainServer(grpc::ServerContext* context, const std::string& server) {
  parts_.env_servers->Drain(server);
  absl::Status status = WaitFor(
      context, [&] { return parts_.env_servers->IsDrained(server); },
      "actors with --envservers=learner move their games away, but it still has some; those of actors that were given "
      "its address stay");
  if (status.ok()) LogInfo("environment server %s is drained", server);
  return status;
}

absl::Status AdminServiceImpl::NoSuchWorker(absl::string_view name) const {
  std::vector<std::string> workers;
  for (const LaneLedger::ActorInfo& actor : parts_.ledger->Actors()) workers.push_back(actor.name);
  for (const ServerRegistry::Server& server : parts_.env_servers->All()) workers.push_back(server.name);
  return absl::NotFoundError(absl::StrFormat(
      "no worker \"%s\" has joined or registered; there are: %s", name,
      workers.empty() ? "none (environment servers register with --learner)" : absl::StrJoin(workers, ", ")));
}

grpc::Status AdminServiceImpl::Stop(grpc::ServerContext* context, const v1::StopRequest* /*request*/,
                                    v1::StopReply* /*reply*/) {
  LogInfo("admin %s: stop", context->peer());
  parts_.stop();
  return grpc::Status::OK;
}

}  // namespace craftfleet
