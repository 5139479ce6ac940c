// The sessions with the environment servers of a directory.

#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "actor/env_client.h"
#include "actor/env_directory.h"
#include "actor/server_health.h"
#include "common/base/backoff.h"
#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/telemetry/limited_log.h"

namespace craftfleet {

// At most one session with each server. Servers are numbered 0..size()-1 in the order of the directory, until the next
// Follow. A server that can't be reached is retried after growing pauses. Owned by one thread; Cancel may be called
// from any.
class EnvConnections {
 public:
  // `health` is not null.
  EnvConnections(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes,
                 std::shared_ptr<ServerHealth> health);

  // Adopts the directory's current list: ends sessions with servers that are no longer listed, keeps the others.
  // Returns whether the list has changed, which renumbers the servers.
  bool Follow() ABSL_LOCKS_EXCLUDED(mu_);

  size_t size() const { return servers_.size(); }
  // The client for `server`; it has a session if connected() is true.
  EnvClient& client(size_t server) { return *servers_[server]->client; }
  const EnvClient& client(size_t server) const { return *servers_[server]->client; }
  std::vector<std::string> Addresses() const;

  // Begins sessions with the servers that are due, answer (ServerHealth) and can be connected to without waiting, as
  // long as file descriptors are available.
  void ConnectReachable();
  // The same, but waits for a server if there is no session yet.
  //   Unavailable: no server can be reached or answers; lists them.   Cancelled: Cancel was called.
  //   Others: the error of the first server, if the directory is fixed and every server is unfit.
  absl::Status ConnectAny();

  // Ends the session with a server that failed because of `why`. `lanes`: the number of its games, for the log.
  //   Cancelled: Cancel was called.
  absl::Status Drop(size_t server, const absl::Status& why, int lanes);
  // Delays the next session with `server` by a pause.
  void Postpone(size_t server);
  ServerHealth::View HealthOf(size_t server) const { return health_->Of(client(server).address()); }
  // Whether the games of a server of this health must go: it does not answer, or it is slow and another server that is
  // not is connected.
  bool MustLeave(const ServerHealth::View& health) const;
  void NoteStep(size_t server, absl::Duration time) { health_->NoteStep(client(server).server(), time); }
  // Ends all sessions.
  void DisconnectAll();
  // Ends all sessions for good; from any thread.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Server {
    std::unique_ptr<EnvClient> client;
    absl::Time next_try = absl::InfinitePast();  // to connect; SteadyNow
    Backoff backoff{absl::Milliseconds(250), absl::Seconds(5)};
    absl::Status error;  // why there is no session; ok: there is one, or none was tried yet
  };

  // Waits until one server is connected, and a moment longer for others.
  void WaitForServers() ABSL_LOCKS_EXCLUDED(mu_);
  // Begins sessions with slow servers.
  void ConnectSlow();
  // Explains why no server is connected.
  absl::Status WhyNone() const;
  void Connect(Server* server);
  void TryLater(Server* server, const absl::Status& error);
  // Remembers why there is no session with `server`, and logs it once.
  void SetError(Server* server, const absl::Status& error);
  // Logs what a server did; few lines of each kind of error, whatever it does.
  void Warn(const Server& server, const absl::Status& error, absl::string_view text);
  bool AnyConnected() const;
  bool cancelled() const ABSL_LOCKS_EXCLUDED(mu_);

  const std::shared_ptr<EnvDirectory> directory_;
  const v1::SessionHello hello_;
  const int frame_bytes_;
  const std::shared_ptr<ServerHealth> health_;
  RealClock clock_;
  LimitedLog log_{&clock_};
  bool ever_connected_ = false;
  int64_t generation_ = 0;  // of the directory, as followed

  mutable Mutex mu_;  // protects the list from Cancel; only the owning thread changes the list
  std::vector<std::unique_ptr<Server>> servers_;
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet
