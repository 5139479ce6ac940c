#include "deploy/cli/top/status_watcher.h"

#include <utility>

#include "craftfleet/v1/status.grpc.pb.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kRetry = absl::Seconds(1);

}  // namespace

StatusWatcher::StatusWatcher(wire::Endpoint process, absl::Duration interval)
    : process_(std::move(process)), interval_(interval), thread_([this] { Run(); }) {}

StatusWatcher::~StatusWatcher() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    if (context_ != nullptr) context_->TryCancel();
    stopped_.NotifyAll();
  }
  thread_.join();
}

StatusWatcher::Seen StatusWatcher::Last() const {
  const MutexLock lock(&mu_);
  return seen_;
}

void StatusWatcher::Run() {
  while (true) {
    absl::Status status = Watch();
    const MutexLock lock(&mu_);
    context_ = nullptr;
    seen_.error = std::move(status);
    if (stopped_.WaitFor(&mu_, kRetry, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_; })) return;
  }
}

absl::Status StatusWatcher::Watch() {
  v1::WatchRequest request;
  request.set_interval_ms(static_cast<int>(absl::ToInt64Milliseconds(interval_)));
  const auto stub = v1::StatusService::NewStub(process_.channel);
  std::unique_ptr<grpc::ClientReader<v1::StatusReply>> reader;
  {
    const MutexLock lock(&mu_);
    if (stopping_) return absl::CancelledError("stopping");
    context_ = std::make_unique<grpc::ClientContext>();
    reader = stub->WatchStatus(context_.get(), request);
  }
  v1::StatusReply reply;
  while (reader->Read(&reply)) {
    const MutexLock lock(&mu_);
    ++seen_.number;
    seen_.status = reply;
    seen_.error = absl::OkStatus();
  }
  const absl::Status status = wire::FromCall(reader->Finish(), process_.address, process_);
  return status.ok() ? absl::UnavailableError(process_.address + ": the process ended the stream") : status;
}

}  // namespace craftfleet
