#include "common/wire/stream_watch.h"

#include <grpc/grpc.h>

#include <absl/strings/match.h>
#include <absl/strings/str_format.h>

namespace craftfleet::wire {

std::string ClientOfPeer(absl::string_view peer) {
  if (!absl::StartsWith(peer, "ipv")) return std::string(peer.substr(0, peer.find(':')));
  return std::string(peer.substr(0, peer.rfind(':')));
}

StreamWatch::Stream::Stream(StreamWatch* watch, grpc::ServerContextBase* context)
    : watch_(watch),
      call_(context->c_call()),
      client_(ClientOfPeer(context->peer())),
      timer_(Watchdog::OfProcess(), [this] {
        is_late_ = true;
        // ServerContext::TryCancel cannot pass a reason to the client.
        grpc_call_cancel_with_status(call_, GRPC_STATUS_DEADLINE_EXCEEDED, LateMessage().c_str(), nullptr);
      }) {
  if (call_ != nullptr) grpc_call_ref(call_);
  const MutexLock lock(&watch_->mu_);
  int& count = watch_->per_client_[client_];
  if (count >= watch_->max_per_client_) {
    admitted_ = absl::ResourceExhaustedError(
        absl::StrFormat("%s has %d streams here already, all that one client may have", client_, count));
    return;
  }
  ++count;
}

StreamWatch::Stream::~Stream() {
  timer_.Disarm();
  if (admitted_.ok()) {
    const MutexLock lock(&watch_->mu_);
    const auto count = watch_->per_client_.find(client_);
    if (--count->second == 0) watch_->per_client_.erase(count);
  }
  if (call_ != nullptr) grpc_call_unref(call_);
}

void StreamWatch::Stream::Await(const char* what, absl::Duration limit) {
  timer_.Disarm();
  what_ = what;
  limit_ = limit;
  timer_.Arm(limit);
}

std::string StreamWatch::Stream::LateMessage() const {
  return absl::StrFormat("waited %s for %s", absl::FormatDuration(limit_), what_);
}

}  // namespace craftfleet::wire
