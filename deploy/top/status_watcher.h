// The last status of a process, kept up to date.

#ifndef CRAFTFLEET_DEPLOY_TOP_STATUS_WATCHER_H_
#define CRAFTFLEET_DEPLOY_TOP_STATUS_WATCHER_H_

#include <cstdint>
#include <memory>
#include <string>
#include <thread>

#include <absl/status/status.h>
#include <absl/time/time.h>
#include <grpcpp/client_context.h>

#include "common/mutex.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Watches on a thread of its own, and begins anew when the process goes and comes back. Thread-safe.
class StatusWatcher {
 public:
  struct Seen {
    int64_t number = 0;      // of replies so far; 0: there was none
    v1::StatusReply status;  // the last one
    absl::Status trouble;    // why there is no newer one; ok: one is on its way
  };

  StatusWatcher(wire::Endpoint process, absl::Duration interval);
  ~StatusWatcher();

  Seen Last() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Takes in replies until the stream ends; returns why it did.
  absl::Status Watch() ABSL_LOCKS_EXCLUDED(mu_);

  const wire::Endpoint process_;
  const absl::Duration interval_;
  mutable Mutex mu_;
  CondVar stopped_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);  // of the stream under way
  Seen seen_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_TOP_STATUS_WATCHER_H_
