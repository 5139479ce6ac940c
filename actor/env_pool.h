// The games that one loop plays, spread over environment servers.

#ifndef CRAFTFLEET_ACTOR_ENV_POOL_H_
#define CRAFTFLEET_ACTOR_ENV_POOL_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/time/time.h>
#include <absl/types/optional.h>
#include <absl/types/span.h>

#include "actor/env_client.h"
#include "actor/env_directory.h"
#include "actor/server_book.h"
#include "actor/server_health.h"
#include "common/backoff.h"
#include "common/mutex.h"
#include "common/types.h"

namespace craftfleet {

// Games are opened on the reachable server that has fewest of them and that answers (ServerHealth). When a server fails
// its games are closed, those on others stay; calls say by `lost` which lanes that were, and the caller opens them
// again, which lands on the servers that are left. Servers that come and go between fragments are taken in by Refresh.
// What a server says makes none of these calls fail, unless there is no other (error_policy.h). Owned by one thread;
// Cancel may be called from any.
class EnvPool {
 public:
  // `first` says which of equally loaded servers is taken, so that many pools don't all begin with the same one.
  // `health` is shared by those who play on the same servers; null: nobody else does.
  EnvPool(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes, size_t first = 0,
          std::shared_ptr<ServerHealth> health = nullptr);

  // Follows the directory: takes in new servers, leaves those that are gone or under suspicion, and closes games where
  // a server has at least two more than another. Returns the lanes that were closed: open them again. Never waits for a
  // server.
  std::vector<int> Refresh();

  // Opens games (one that is open already begins anew); their observations, uint8[n,H,W,3], go to `frames`. Where a
  // server fails at it another is taken. `refused`: lanes whose snapshot is no game to two servers, or to the only one;
  // their rows of `frames` mean nothing.
  //   Unavailable: no server can be reached or answers; names each.   Cancelled: Cancel was called.
  //   Others: the directory is fixed and no server fits; the first one's error.
  // After an error every game is closed.
  absl::Status Open(absl::Span<const EnvClient::Lane> lanes, std::string* frames, std::vector<int>* lost,
                    std::vector<EnvClient::Refused>* refused);

  // Closes those of `lanes` that are open. After an error every game is closed.
  absl::Status Close(absl::Span<const int> lanes, std::vector<int>* lost);

  // The open lanes in the order in which Step wants them: server by server.
  std::vector<int> Arrange(std::vector<int> lanes) const;

  // Steps `lanes`, arranged; rows of `batch` stand in their order, without those that are lost.
  //   Unavailable: all lanes are lost; says why.   Cancelled: Cancel was called. Every game is closed then.
  absl::Status Step(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot, StepBatch* batch,
                    std::vector<int>* lost);

  // How long the slowest server was busy with the last step.
  absl::Duration busy() const { return busy_; }
  // What is known of each server.
  std::vector<ServerBook::Server> Report() const;

  // Ends all sessions, and with them all games.
  void Reset();

  // Ends all sessions for good; from any thread.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Server {
    std::unique_ptr<EnvClient> client;
    absl::Time next_try = absl::InfinitePast();  // to connect; SteadyNow
    Backoff backoff{absl::Milliseconds(250), absl::Seconds(5)};
    absl::Status trouble;  // why there is no session; ok: there is one, or it was not tried yet
    int lanes = 0;
    StepBatch batch;  // reused
  };

  // A lane whose snapshot one server did not take.
  struct Refusal {
    size_t server = 0;
    std::string reason;
  };
  // What Open has under way.
  struct Opening {
    absl::Span<const EnvClient::Lane> lanes;
    std::string* frames;
    std::vector<int>* lost;
    std::vector<EnvClient::Refused>* refused;
    std::vector<int> rows;            // of `lanes`: still to be opened
    std::map<int, Refusal> refusals;  // by row: to be tried on a second server
  };

  // Makes servers_ those of the directory. Returns the lanes that were open on others.
  std::vector<int> FollowDirectory() ABSL_LOCKS_EXCLUDED(mu_);
  // Connects to the servers whose time has come, that answer and where it takes no waiting; leaves out those for which
  // there are no files left.
  void ConnectReachable();
  // The same, but waits for one if there is no other. Errors as Open.
  absl::Status ConnectServers();
  // Waits until one is connected, and a moment for others. False: nothing comes of waiting on.
  void WaitForServers() ABSL_LOCKS_EXCLUDED(mu_);
  // Why none is connected.
  absl::Status WhyNone() const;
  void Connect(Server* server);
  // Ends sessions with servers that others found not to answer.
  absl::Status LoseSuspects(std::vector<int>* lost);
  bool cancelled() const ABSL_LOCKS_EXCLUDED(mu_);
  static void TryLater(Server* server, const absl::Status& trouble);
  // Remembers why there is no session with `server`, and says it once.
  static void Note(Server* server, const absl::Status& trouble);
  bool AnyConnected() const;
  // Closes games on the fullest servers until none has two more than another.
  void Balance(std::vector<int>* closed);
  // Ends the session with a server that failed, and adds the lanes that were open there to `lost`.
  //   Cancelled: Cancel was called.
  absl::Status Lose(size_t server, const absl::Status& why, std::vector<int>* lost);
  absl::Status CloseOpenOnes(absl::Span<const int> lanes, std::vector<int>* lost);
  // Opens the rows of `opening`, none of them open, on the servers that have fewest; leaves in it those whose server
  // failed or refused them.
  absl::Status Spread(Opening* opening);
  // Of those that are connected, `except` left out; nothing: there is none.
  absl::optional<size_t> LeastLoaded(absl::optional<size_t> except) const;
  // Leaves in `rows` those that the server refused, with their reasons in `reasons`.
  absl::Status OpenOn(size_t server, const Opening& opening, std::vector<int>* rows, std::vector<std::string>* reasons);
  // What `server` refused is tried on another, or given up.
  void TakeRefused(size_t server, const std::vector<int>& rows, const std::vector<std::string>& reasons,
                   Opening* opening);
  // `opened` on `server`: who refused one of them does not say the truth.
  absl::Status BlameRefusals(size_t server, absl::Span<const int> opened, Opening* opening);
  // The rows of `lanes`, arranged, that are on `server`: [first, last).
  std::pair<size_t, size_t> RowsOn(size_t server, absl::Span<const int> lanes) const;
  absl::Status SendAndReceive(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot,
                              StepBatch* batch, std::vector<int>* lost);

  const std::shared_ptr<EnvDirectory> directory_;
  const v1::SessionHello hello_;
  const int frame_bytes_;
  const size_t first_;
  const std::shared_ptr<ServerHealth> health_;
  bool ever_connected_ = false;
  int64_t generation_ = 0;           // of the directory, as followed
  std::map<int, size_t> server_of_;  // index into servers_, by lane
  absl::Duration busy_;

  mutable Mutex mu_;  // guards the list of servers against Cancel; its owner alone changes it
  std::vector<std::unique_ptr<Server>> servers_;
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ENV_POOL_H_
