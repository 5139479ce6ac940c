// Which environment servers answer, as all threads of an actor see it.

#ifndef CRAFTFLEET_ACTOR_SERVER_HEALTH_H_
#define CRAFTFLEET_ACTOR_SERVER_HEALTH_H_

#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "actor/env_client.h"
#include "common/mutex.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/environment.pb.h"

namespace craftfleet {

// A server that is new here, or that was put under suspicion, has to answer a probe before games are opened on it: a
// whole session of one game and one step, on a thread beside play, with a deadline for each request. One that fails is
// probed again after a pause that doubles, or as soon as a new connection to it comes about. Thread-safe.
class ServerHealth {
 public:
  static constexpr absl::Duration kFirstPause = absl::Seconds(2);
  static constexpr absl::Duration kLastPause = absl::Minutes(5);
  // One that has answered for so long begins with the first pause again.
  static constexpr absl::Duration kForgiveAfter = absl::Minutes(5);
  static constexpr size_t kMaxProbes = 16;  // at once

  struct Options {
    v1::SessionHello hello;  // what probes begin with
    int frame_bytes = 0;     // as hello asks for
    absl::Duration timeout = kDefaultEnvTimeout;
    absl::Duration first_pause = kFirstPause;
    absl::Duration last_pause = kLastPause;
  };

  explicit ServerHealth(Options options);
  // Ends the probes that are under way; takes a second at most.
  ~ServerHealth();

  // Whether games may be opened on `server`, which can be connected to. Never waits: of one that is new here the answer
  // is no until it has been probed. A server within this process may at first.
  bool MayUse(const wire::Endpoint& server) ABSL_LOCKS_EXCLUDED(mu_);
  // It missed a deadline or answered nonsense.
  void Suspect(const wire::Endpoint& server, const absl::Status& why) ABSL_LOCKS_EXCLUDED(mu_);
  // Why it is left alone; ok: it is not.
  absl::Status TroubleOf(const std::string& address) const ABSL_LOCKS_EXCLUDED(mu_);

  // Of each request to a server.
  absl::Duration timeout() const { return options_.timeout; }

 private:
  enum class State { kNew, kGood, kSuspect };
  struct Server {
    State state = State::kNew;
    absl::Status trouble;               // of a suspect
    std::unique_ptr<EnvClient> client;  // for probes; null while it is good
    bool was_reachable = false;         // when it was looked at last
    absl::Duration pause;               // before the next probe; zero: none failed lately
    absl::Time next_probe;              // SteadyNow, as all times here
    absl::Time last_probe = absl::InfinitePast();
    absl::Time good_since = absl::InfiniteFuture();
    absl::Time asked_for;  // last
    std::thread prober;    // joined by thread_
    bool probing = false;
  };

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Begins the probes that are due, forgets servers that nobody asks for. When to look again.
  absl::Duration Look() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool IsDue(Server* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // A whole session; on a thread of its own.
  void Probe(const std::string& address, EnvClient* client) ABSL_LOCKS_EXCLUDED(mu_);
  void TakeResult(const std::string& address, const absl::Status& result) ABSL_LOCKS_EXCLUDED(mu_);
  void BecomeSuspect(Server* server, const absl::Status& why) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Makes the client that probes it, if there are files left for it.
  void Prepare(const wire::Endpoint& endpoint, Server* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  mutable Mutex mu_;
  CondVar changed_;
  std::map<std::string, Server> servers_ ABSL_GUARDED_BY(mu_);  // by address
  size_t probes_ ABSL_GUARDED_BY(mu_) = 0;                      // under way
  bool news_ ABSL_GUARDED_BY(mu_) = false;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_SERVER_HEALTH_H_
