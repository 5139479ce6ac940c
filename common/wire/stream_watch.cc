#include "common/wire/stream_watch.h"

#include <grpc/grpc.h>

#include <absl/strings/match.h>
#include <absl/strings/str_format.h>

#include "common/base/clock.h"

namespace craftfleet::wire {
namespace {

constexpr absl::Duration kCheckEvery = absl::Milliseconds(250);

}  // namespace

std::string ClientOfPeer(absl::string_view peer) {
  if (!absl::StartsWith(peer, "ipv")) return std::string(peer.substr(0, peer.find(':')));
  return std::string(peer.substr(0, peer.rfind(':')));
}

StreamWatch::Stream::Stream(StreamWatch* watch, grpc::ServerContextBase* context)
    : watch_(watch), call_(context->c_call()), client_(ClientOfPeer(context->peer())) {
  if (call_ != nullptr) grpc_call_ref(call_);
  const MutexLock lock(&watch_->mu_);
  int& count = watch_->per_client_[client_];
  if (count >= watch_->max_per_client_) {
    admitted_ = absl::ResourceExhaustedError(
        absl::StrFormat("%s has %d streams here already, all that one client may have", client_, count));
    return;
  }
  ++count;
  const bool is_first = watch_->streams_.empty();
  watch_->streams_[this] = false;
  if (!watch_->started_) {
    watch_->started_ = true;
    watch_->thread_ = std::thread([watch] { watch->Run(); });
  }
  if (is_first) watch_->changed_.NotifyAll();  // otherwise the thread is awake, and there may be thousands of streams
}

StreamWatch::Stream::~Stream() {
  {
    const MutexLock lock(&watch_->mu_);
    if (watch_->streams_.erase(this) > 0) {
      const auto count = watch_->per_client_.find(client_);
      if (--count->second == 0) watch_->per_client_.erase(count);
    }
  }
  if (call_ != nullptr) grpc_call_unref(call_);
}

void StreamWatch::Stream::Await(const char* what, absl::Duration limit) {
  deadline_ns_ = 0;
  if (limit == absl::InfiniteDuration()) return;
  what_ = what;
  limit_ns_ = absl::ToInt64Nanoseconds(limit);
  deadline_ns_ = absl::ToUnixNanos(SteadyNow()) + absl::ToInt64Nanoseconds(limit);
}

std::string StreamWatch::Stream::LateMessage() const {
  return absl::StrFormat("waited %s for %s", absl::FormatDuration(absl::Nanoseconds(limit_ns_.load())), what_.load());
}

absl::Status StreamWatch::Stream::late() const {
  const MutexLock lock(&watch_->mu_);
  const auto found = watch_->streams_.find(this);
  return found != watch_->streams_.end() && found->second ? absl::DeadlineExceededError(LateMessage())
                                                          : absl::OkStatus();
}

StreamWatch::~StreamWatch() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

int StreamWatch::size() const {
  const MutexLock lock(&mu_);
  return static_cast<int>(streams_.size());
}

void StreamWatch::Run() {
  const MutexLock lock(&mu_);
  while (!stopping_) {
    changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || !streams_.empty(); });
    CancelLate();
    changed_.WaitFor(&mu_, kCheckEvery, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_; });
  }
}

void StreamWatch::CancelLate() {
  const int64_t now = absl::ToUnixNanos(SteadyNow());
  for (auto& [stream, cancelled] : streams_) {
    const int64_t deadline = stream->deadline_ns_;
    if (deadline == 0 || now < deadline || cancelled) continue;
    cancelled = true;
    // ServerContext::TryCancel cannot pass a reason to the client.
    grpc_call_cancel_with_status(stream->call_, GRPC_STATUS_DEADLINE_EXCEEDED, stream->LateMessage().c_str(), nullptr);
  }
}

}  // namespace craftfleet::wire
