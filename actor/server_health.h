// Knows which environment servers answer, and how fast; shared by all threads of an actor.

#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "actor/env_client.h"
#include "actor/step_times.h"
#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/environment.pb.h"

namespace craftfleet {

// A new or suspect server must answer a probe before games are opened on it: a whole session of one game and one step,
// on its own thread, with a deadline for each request. After a failed probe, the next one follows after a pause, which
// doubles each time, or as soon as there is a new connection.
//
// A slow server (StepTimes) gets games only if there is no other. It is probed for some seconds, so that trying it
// again holds up no game, and must be as fast in them as the others. Time in which this process was itself stopped, as
// on a host that swaps, counts for no server. Thread-safe.
class ServerHealth {
 public:
  static constexpr absl::Duration kFirstPause = absl::Seconds(2);
  static constexpr absl::Duration kLastPause = absl::Minutes(5);
  static constexpr absl::Duration kFirstPauseOfSlow = absl::Seconds(10);
  // After answering for this long, a server starts with the first pause again.
  static constexpr absl::Duration kForgiveAfter = absl::Minutes(5);
  static constexpr size_t kMaxProbes = 16;  // at once

  struct Options {
    v1::SessionHello hello;  // the first request of probes
    int frame_bytes = 0;     // of frames with hello's size
    absl::Duration timeout = kDefaultEnvTimeout;
    absl::Duration first_pause = kFirstPause;
    absl::Duration last_pause = kLastPause;
  };

  // What is known of a server.
  struct View {
    absl::Status error;         // why it gets no games, or only for want of another; ok: it answers, or is unknown
    bool is_slow = false;       // it answers, but slowly
    bool should_leave = false;  // a slow one: its games should move to any other server that has no error
    // The typical time of a step there (StepTimes); of a slow one, as last measured. nullopt: not known yet.
    std::optional<absl::Duration> step_time;
  };

  explicit ServerHealth(Options options);
  // Ends running probes; takes at most a second.
  ~ServerHealth();

  // Whether games may be opened on `server`, which is reachable. Never waits: false for a new server until it
  // has been probed. A server within this process needs no probe at first.
  bool MayUse(const wire::Endpoint& server) ABSL_LOCKS_EXCLUDED(mu_);
  // Marks a server that missed a deadline or sent an invalid answer as suspect. `why` is logged.
  void Suspect(const wire::Endpoint& server, const absl::Status& why) ABSL_LOCKS_EXCLUDED(mu_);
  // A step of the games on `server` took `time`.
  void NoteStep(const wire::Endpoint& server, absl::Duration time) ABSL_LOCKS_EXCLUDED(mu_);
  View Of(const std::string& address) const ABSL_LOCKS_EXCLUDED(mu_);

  // The timeout of each request to a server.
  absl::Duration timeout() const { return options_.timeout; }

 private:
  enum class State { kNew, kGood, kSlow, kSuspect };
  struct Server {
    State state = State::kNew;
    absl::Status error;                           // of a suspect or slow one
    absl::Duration step_time;                     // of a slow one, when it was last measured
    bool should_leave = false;                    // a slow one: others are faster, or not known
    absl::Time last_step = absl::InfinitePast();  // of games, other than the probes'
    std::unique_ptr<EnvClient> client;            // for probes; null while it is good
    bool was_reachable = false;                   // when it was last checked
    absl::Duration pause;                         // before the next probe; zero: no recent failure
    absl::Time next_probe;                        // SteadyNow, as all times here
    absl::Time last_probe = absl::InfinitePast();
    absl::Time good_since = absl::InfiniteFuture();
    absl::Time asked_for;  // last call of MayUse
    std::thread prober;    // joined by thread_
    bool probing = false;
  };

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Begins the probes that are due and forgets servers that are no longer used. Returns the time until the next look.
  absl::Duration Look() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool IsDue(Server* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Runs a probe, on its own thread.
  void Probe(const std::string& address, EnvClient* client) ABSL_LOCKS_EXCLUDED(mu_);
  // Plays one game for `duration`, at least a step. Returns the mean time of a step.
  absl::StatusOr<absl::Duration> PlayProbe(EnvClient* client, absl::Duration duration) ABSL_LOCKS_EXCLUDED(mu_);
  void TakeResult(const std::string& address, const absl::StatusOr<absl::Duration>& step_time) ABSL_LOCKS_EXCLUDED(mu_);
  void BecomeSlow(const std::string& address, absl::Duration step_time, Server* server)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void BecomeGood(const std::string& address, Server* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Sets the time of the next probe; the pauses double, beginning with `first`.
  void Postpone(absl::Duration first, Server* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool IsStopping() const ABSL_LOCKS_EXCLUDED(mu_);
  // The time since `begun` without that in which this process was stopped.
  absl::Duration RunningSince(absl::Time begun) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void BecomeSuspect(Server* server, const absl::Status& why) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Creates the client for probes, if enough file descriptors are available.
  void Prepare(const wire::Endpoint& endpoint, Server* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  mutable Mutex mu_;
  CondVar changed_;
  std::map<std::string, Server> servers_ ABSL_GUARDED_BY(mu_);  // by address
  StepTimes step_times_ ABSL_GUARDED_BY(mu_);                   // of servers with games
  size_t probes_ ABSL_GUARDED_BY(mu_) = 0;                      // under way
  bool changed_state_ ABSL_GUARDED_BY(mu_) = false;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  // The last time in which this process was stopped, since thread_ ran late; and when thread_ ran last.
  absl::Time pause_begin_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();
  absl::Time pause_end_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();
  absl::Time beat_ ABSL_GUARDED_BY(mu_) = SteadyNow();
  std::thread thread_;
};

}  // namespace craftfleet
