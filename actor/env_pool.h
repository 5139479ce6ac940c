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
#include <absl/types/span.h>

#include "actor/env_client.h"
#include "actor/env_directory.h"
#include "actor/server_book.h"
#include "common/backoff.h"
#include "common/mutex.h"
#include "common/types.h"

namespace craftfleet {

// Games are opened on the reachable server that has fewest of them. When a server fails its games are closed, those on
// others stay; calls say by `lost` which lanes that were, and the caller opens them again, which lands on the servers
// that are left. Servers that come and go between fragments are taken in by Refresh. Owned by one thread; Cancel may be
// called from any.
class EnvPool {
 public:
  // `first` says which of equally loaded servers is taken, so that many pools don't all begin with the same one.
  EnvPool(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes, size_t first = 0);

  // Follows the directory: takes in new servers, leaves those that are gone, and closes games where a server has at
  // least two more than another. Returns the lanes that were closed: open them again. Never waits for a server.
  std::vector<int> Refresh();

  // Opens games (one that is open already begins anew); their observations, uint8[n,H,W,3], go to `frames`. Where a
  // server fails at it another is taken.
  //   Unavailable: no server can be reached; names each.   Others as EnvClient, where waiting helps with none of them.
  // After an error every game is closed.
  absl::Status Open(absl::Span<const EnvClient::Lane> lanes, std::string* frames, std::vector<int>* lost);

  // Closes those of `lanes` that are open. After an error every game is closed.
  absl::Status Close(absl::Span<const int> lanes, std::vector<int>* lost);

  // The open lanes in the order in which Step wants them: server by server.
  std::vector<int> Arrange(std::vector<int> lanes) const;

  // Steps `lanes`, arranged; rows of `batch` stand in their order, without those that are lost.
  //   The server's error, if it is not one that passes (MayPass) or if all lanes are lost; every game is closed then.
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
    absl::Time next_try = absl::InfinitePast();  // to connect
    Backoff backoff{absl::Milliseconds(250), absl::Seconds(5)};
    absl::Status trouble;  // why there is no session; ok: there is one, or it was not tried yet
    int lanes = 0;
    StepBatch batch;  // reused
  };

  // Makes servers_ those of the directory. Returns the lanes that were open on others.
  std::vector<int> FollowDirectory() ABSL_LOCKS_EXCLUDED(mu_);
  // Connects to the servers whose time has come and where it takes no waiting; leaves out those for which there are no
  // files left.
  void ConnectReachable();
  // The same, but waits for one if there is no other. Errors as Open.
  absl::Status ConnectServers();
  void Connect(Server* server, absl::Duration timeout);
  static void TryLater(Server* server, const absl::Status& trouble);
  // Remembers why there is no session with `server`, and says it once.
  static void Note(Server* server, const absl::Status& trouble);
  bool AnyConnected() const;
  // Closes games on the fullest servers until none has two more than another.
  void Balance(std::vector<int>* closed);
  // Ends the session with a server that failed, and adds the lanes that were open there to `lost`.
  //   `why`, if that is no trouble that passes.
  absl::Status Lose(size_t server, const absl::Status& why, std::vector<int>* lost);
  absl::Status CloseOpenOnes(absl::Span<const int> lanes, std::vector<int>* lost);
  // Opens the chosen `rows` of `lanes`, none of them open, on the servers that have fewest; leaves in `rows` those
  // whose server failed.
  absl::Status Spread(absl::Span<const EnvClient::Lane> lanes, std::string* frames, std::vector<int>* rows,
                      std::vector<int>* lost);
  size_t LeastLoaded() const;
  absl::Status OpenOn(size_t server, absl::Span<const EnvClient::Lane> lanes, absl::Span<const int> rows,
                      std::string* frames);
  // The rows of `lanes`, arranged, that are on `server`: [first, last).
  std::pair<size_t, size_t> RowsOn(size_t server, absl::Span<const int> lanes) const;
  absl::Status SendAndReceive(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot,
                              StepBatch* batch, std::vector<int>* lost);

  const std::shared_ptr<EnvDirectory> directory_;
  const v1::SessionHello hello_;
  const int frame_bytes_;
  const size_t first_;
  int64_t generation_ = 0;           // of the directory, as followed
  std::map<int, size_t> server_of_;  // index into servers_, by lane
  absl::Duration busy_;

  Mutex mu_;  // guards the list of servers against Cancel; its owner alone changes it
  std::vector<std::unique_ptr<Server>> servers_;
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ENV_POOL_H_
