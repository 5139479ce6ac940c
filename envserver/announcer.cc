#include "envserver/announcer.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>

#include "common/base/backoff.h"
#include "common/base/status_macros.h"
#include "common/process/version.h"
#include "common/telemetry/log.h"
#include "common/wire/protocol.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kTimeout = absl::Seconds(2);
constexpr absl::Duration kShortestInterval = absl::Milliseconds(100);
constexpr absl::Duration kLongestInterval = absl::Seconds(10);

}  // namespace

absl::Duration AnnouncementInterval(const v1::AnnounceReply& reply) {
  return std::clamp(absl::Milliseconds(reply.lease_ms()) / 8, kShortestInterval, kLongestInterval);
}

Announcer::Announcer(wire::Endpoint learner, const std::string& name, const std::string& address,
                     const std::string& texture_digest, const std::string& canary,
                     std::function<v1::ProcessSummary()> summarize,
                     std::function<void(const std::string& run_id)> registered)
    : learner_(std::move(learner)),
      stub_(v1::LearnerService::NewStub(learner_.channel)),
      summarize_(std::move(summarize)),
      registered_(std::move(registered)) {
  announcement_.set_protocol_version(wire::kProtocolVersion);
  announcement_.set_name(name);
  announcement_.set_address(address);
  announcement_.set_texture_digest(texture_digest);
  announcement_.set_build(BuildId());
  announcement_.set_canary(canary);
  thread_ = std::thread([this] { Run(); });
}

Announcer::~Announcer() { Leave(); }

void Announcer::Leave() {
  {
    const MutexLock lock(&mu_);
    leaving_ = true;
    changed_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

void Announcer::Run() {
  Backoff backoff(absl::Milliseconds(250), absl::Seconds(2));
  std::string last_error;
  bool known = false;
  bool ever_known = false;
  while (true) {
    const absl::StatusOr<v1::AnnounceReply> reply = Announce(/*leaving=*/false);
    const absl::Status status = reply.status();
    if (status.ok() && !known) LogInfo("registered with learner %s", learner_.address);
    if (!status.ok() && last_error != status.message()) {
      LogWarning("%s; trying again until it answers", status.message());
    }
    known = status.ok();
    if (known && registered_ != nullptr) registered_(reply->run_id());
    ever_known |= known;
    last_error = std::string(status.message());
    if (known) backoff.Reset();
    const MutexLock lock(&mu_);
    changed_.WaitFor(&mu_, known ? AnnouncementInterval(*reply) : backoff.Next(),
                     [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return leaving_; });
    if (leaving_) break;
  }
  // If this does not arrive, the learner drops the server when its lease ends.
  if (ever_known) Announce(/*leaving=*/true).status().IgnoreError();
}

absl::StatusOr<v1::AnnounceReply> Announcer::Announce(bool leaving) {
  announcement_.set_leaving(leaving);
  *announcement_.mutable_summary() = summarize_();
  grpc::ClientContext context;
  wire::SetDeadline(&context, kTimeout);
  v1::AnnounceReply reply;
  CRAFTFLEET_RETURN_IF_ERROR(wire::FromCall(stub_->Announce(&context, announcement_, &reply),
                                            absl::StrCat("learner ", learner_.address), learner_));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("run_id", reply.run_id()));
  return reply;
}

}  // namespace craftfleet
