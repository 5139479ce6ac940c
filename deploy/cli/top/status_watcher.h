// Keeps the latest status of a process up to date.

#ifndef CRAFTFLEET_DEPLOY_CLI_TOP_STATUS_WATCHER_H_
#define CRAFTFLEET_DEPLOY_CLI_TOP_STATUS_WATCHER_H_

#include <cstdint>
#include <memory>
#include <string>
#include <thread>

#include <absl/status/status.h>
#include <absl/time/time.h>
#include <grpcpp/client_context.h>

#include "common/base/mutex.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Watches on a thread of its own, and reconnects after the process has restarted. Thread-safe.
class StatusWatcher {
 public:
  struct Seen {
    int64_t number = 0;      // replies so far
    v1::StatusReply status;  // the last one
    absl::Status error;      // the reason why there is no newer one; ok while the stream is open
  };

  StatusWatcher(wire::Endpoint process, absl::Duration interval);
  ~StatusWatcher();

  Seen Last() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Receives replies until the stream ends; returns the reason.
  absl::Status Watch() ABSL_LOCKS_EXCLUDED(mu_);

  const wire::Endpoint process_;
  const absl::Duration interval_;
  mutable Mutex mu_;
  CondVar stopped_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);  // of the open stream
  Seen seen_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_TOP_STATUS_WATCHER_H_
