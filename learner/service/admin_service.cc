#include "learner/service/admin_service.h"

#include <algorithm>
#include <chrono>

#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/telemetry/log.h"
#include "common/wire/grpc_status.h"
#include "learner/service/worker_page.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kTick = absl::Milliseconds(20);
constexpr absl::Duration kLongest = absl::Hours(24);
constexpr absl::Duration kLeastMargin = absl::Milliseconds(50);
constexpr absl::Duration kMostMargin = absl::Seconds(1);

// The time until the client's deadline, less a margin of a tenth, so that the reply arrives in time even on a busy
// host.
absl::Duration TimeLeft(const grpc::ServerContext& context) {
  const absl::Duration left = absl::FromChrono(context.deadline()) - absl::Now();
  return std::clamp(left - std::clamp(left / 10, kLeastMargin, kMostMargin), absl::ZeroDuration(), kLongest);
}

// As the log names the client.
std::string CallerOf(const grpc::ServerContext& context) { return absl::StrCat("admin ", context.peer()); }

}  // namespace

absl::Status AdminServiceImpl::WaitFor(grpc::ServerContext* context, const std::function<bool()>& done,
                                       absl::string_view otherwise) {
  const absl::Time end = SteadyNow() + TimeLeft(*context);
  while (!done()) {
    if (context->IsCancelled()) return absl::CancelledError("the client disconnected");
    if (SteadyNow() > end) return absl::DeadlineExceededError(otherwise);
    absl::SleepFor(kTick);
  }
  return absl::OkStatus();
}

grpc::Status AdminServiceImpl::Checkpoint(grpc::ServerContext* context, const v1::CheckpointRequest* /*request*/,
                                          v1::CheckpointReply* reply) {
  const absl::StatusOr<int64_t> iteration = steering_->Checkpoint(CallerOf(*context), TimeLeft(*context));
  if (!iteration.ok()) return wire::ToGrpc(iteration.status());
  reply->set_iteration(*iteration);
  return grpc::Status::OK;
}

grpc::Status AdminServiceImpl::Pause(grpc::ServerContext* context, const v1::PauseRequest* /*request*/,
                                     v1::PauseReply* /*reply*/) {
  steering_->Pause(CallerOf(*context));
  const absl::Status status = WaitFor(
      context, [this] { return steering_->IsStill(); }, "paused, but some fragments are still being played");
  if (status.ok()) LogInfo("paused: no fragments are played until craftfleet admin resume");
  return wire::ToGrpc(status);
}

grpc::Status AdminServiceImpl::Resume(grpc::ServerContext* context, const v1::ResumeRequest* /*request*/,
                                      v1::ResumeReply* reply) {
  reply->set_was_paused(steering_->Resume(CallerOf(*context)));
  return grpc::Status::OK;
}

grpc::Status AdminServiceImpl::Drain(grpc::ServerContext* context, const v1::DrainRequest* request,
                                     v1::DrainReply* reply) {
  const absl::StatusOr<WorkerRegistry::WorkerId> worker =
      steering_->SetDraining(CallerOf(*context), request->worker(), /*draining=*/true);
  if (!worker.ok()) return wire::ToGrpc(worker.status());
  const bool is_actor = worker->role == WorkerRole::kActor;
  reply->set_role(RoleName(worker->role));
  const absl::Status status = WaitFor(
      context, [&] { return steering_->IsDrained(*worker); },
      is_actor
          ? "it gets no more permits or evaluations, but has not finished its current ones"
          : "actors with --envservers=learner move their games away, but it still has some; actors that were given "
            "its address keep theirs");
  if (status.ok()) LogInfo("%s %s is drained", is_actor ? "actor" : "environment server", worker->name);
  return wire::ToGrpc(status);
}

grpc::Status AdminServiceImpl::Undrain(grpc::ServerContext* context, const v1::UndrainRequest* request,
                                       v1::UndrainReply* reply) {
  const absl::StatusOr<WorkerRegistry::WorkerId> worker =
      steering_->SetDraining(CallerOf(*context), request->worker(), /*draining=*/false);
  if (worker.ok()) reply->set_role(RoleName(worker->role));
  return wire::ToGrpc(worker.status());
}

grpc::Status AdminServiceImpl::Stop(grpc::ServerContext* context, const v1::StopRequest* /*request*/,
                                    v1::StopReply* /*reply*/) {
  steering_->Stop(CallerOf(*context));
  return grpc::Status::OK;
}

}  // namespace craftfleet
