// Registers this environment server with a learner.

#pragma once

#include <functional>
#include <memory>
#include <string>
#include <thread>

#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/base/mutex.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

// The time from one announcement to the next: an eighth of the learner's lease for servers, within 0.1..10 s.
absl::Duration AnnouncementInterval(const v1::AnnounceReply& reply);

// Announces the server regularly (AnnouncementInterval) on a thread of its own, and retries while the learner is
// unreachable. Thread-safe.
class Announcer {
 public:
  // `name` is the one in the server's own status, `address` where actors find it, `canary` its GameCanary; `summarize`
  // returns what the learner shows in its status. `registered` is called on the announcer's thread after each
  // registration, with the learner's run.
  Announcer(wire::Endpoint learner, const std::string& name, const std::string& address,
            const std::string& texture_digest, const std::string& canary, std::function<v1::ProcessSummary()> summarize,
            std::function<void(const std::string& run_id)> registered = nullptr);
  ~Announcer();

  // Withdraws the announcement, so that actors move their games, and ends the thread. Idempotent.
  void Leave() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<v1::AnnounceReply> Announce(bool leaving);

  const wire::Endpoint learner_;
  const std::unique_ptr<v1::LearnerService::Stub> stub_;
  const std::function<v1::ProcessSummary()> summarize_;
  const std::function<void(const std::string&)> registered_;
  v1::Announcement announcement_;

  Mutex mu_;
  CondVar changed_;
  bool leaving_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet
