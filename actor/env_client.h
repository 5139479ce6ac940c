// One session with one environment server, over a connection of its own.

#ifndef CRAFTFLEET_ACTOR_ENV_CLIENT_H_
#define CRAFTFLEET_ACTOR_ENV_CLIENT_H_

#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "actor/play_reply.h"
#include "common/mutex.h"
#include "common/types.h"
#include "common/watchdog.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/environment.grpc.pb.h"

namespace craftfleet {

// How long a server may take for a request, where nothing else is said; a step of a game takes microseconds.
inline constexpr absl::Duration kDefaultEnvTimeout = absl::Seconds(10);

// A session ends with its first error; Connect begins a new one, without games. Errors name the server's address.
//   Unavailable: the server can't be reached or went away: connect again, later.
//   DeadlineExceeded: it did not answer in time.   DataLoss: its answer can't be (play_reply.h).
//   FailedPrecondition: the handshake does not match.   Cancelled: Cancel was called.   Others: as the server says.
// Owned by one thread; Cancel may be called from any.
class EnvClient {
 public:
  // Games that are opened by one request; more of them take several. A new world takes some hundredths of a second, so
  // such a request has more time: a hundredth of the timeout more for each game.
  static constexpr size_t kOpenAtOnce = 64;

  struct Lane {
    int lane = 0;
    int64_t seed = 0;
    int64_t episode = 1;   // of a new game
    std::string snapshot;  // empty: a new game
  };

  // A lane that the server did not open.
  struct Refused {
    int lane = 0;
    std::string reason;  // for people, as CutReason leaves it
  };

  // `hello` is what each session begins with. `timeout`: for each request, but see kOpenAtOnce.
  EnvClient(const wire::Endpoint& server, v1::SessionHello hello, int frame_bytes,
            absl::Duration timeout = kDefaultEnvTimeout);
  ~EnvClient();

  // Begins a session; waits at most `patience` for a connection, then the constructor's timeout for the answer.
  absl::Status Connect(absl::Duration patience) ABSL_LOCKS_EXCLUDED(mu_);
  bool connected() const { return stream_ != nullptr; }
  // Whether the server can be connected to without waiting; if not, it is being tried now.
  bool Reachable() const;
  // Whether the last try to connect has failed.
  bool Failing() const;

  // Opens games; their observations, uint8[n,H,W,3], go to `frames`, without those of `refused`: lanes whose snapshot
  // is no game to the server. Null: none of `lanes` has a snapshot.
  absl::Status Open(absl::Span<const Lane> lanes, std::string* frames, std::vector<Refused>* refused = nullptr);
  absl::Status Close(absl::Span<const int> lanes);

  // A step in two halves, so that several servers can work at once: SendStep, then ReceiveStep. After an error of
  // either the session is over.
  absl::Status SendStep(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot);
  absl::Status ReceiveStep(StepBatch* batch);

  // Of sessions with `hello.recording`: what the games of the last Open or ReceiveStep looked like after it, in its
  // order; of a game that ended, the last moment of the episode that ended.
  const std::vector<Moment>& moments() const { return moments_; }

  // How long the server was busy with the last reply.
  absl::Duration busy() const { return absl::Nanoseconds(reply_.busy_ns()); }
  // What it last told about itself; empty: nothing yet.
  const v1::ProcessSummary& summary() const { return summary_; }

  // Ends the session at once, from any thread, and every later one.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the session.
  void Disconnect() ABSL_LOCKS_EXCLUDED(mu_);
  // The same, and waits until the server has done so, too.
  void Leave();

  const std::string& address() const { return server_.address; }
  const wire::Endpoint& server() const { return server_; }

 private:
  // Opens those that fit into one request, and appends to `frames` and `refused`.
  absl::Status OpenSome(absl::Span<const Lane> lanes, std::string* frames, std::vector<Refused>* refused);
  // Sends `request_`; there are `limit` for that and for Receive.
  absl::Status Send(absl::Duration limit);
  absl::Status Receive();
  // After hello.   FailedPrecondition: the server plays another game; the session is over.
  absl::Status CheckCanary();
  // Ends the session if `checked`, what is wrong with the reply, is not ok.
  absl::Status Judge(const absl::Status& checked) ABSL_LOCKS_EXCLUDED(mu_);
  // Adds to `moments_` if the session records.
  absl::Status TakeMoments(size_t lanes);
  // The session's error, after a failed read or write.
  absl::Status Broken() ABSL_LOCKS_EXCLUDED(mu_);

  const wire::Endpoint server_;
  const v1::SessionHello hello_;
  const int frame_bytes_;
  const absl::Duration timeout_;
  const PlayReplyCheck check_;
  const std::unique_ptr<v1::EnvironmentService::Stub> stub_;

  v1::PlayRequest request_;  // reused: fresh messages cost page faults
  v1::PlayReply reply_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::PlayRequest, v1::PlayReply>> stream_;
  v1::ProcessSummary summary_;
  std::vector<Moment> moments_;

  Mutex mu_;
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;

  absl::Duration limit_;   // of the request under way
  absl::Time sent_;        // SteadyNow when it was sent
  bool overdue_ = false;   // the session was cancelled for it
  Watchdog::Timer timer_;  // the last member: it cancels context_
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ENV_CLIENT_H_
