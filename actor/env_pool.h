// The games that one loop plays, spread over environment servers.

#ifndef CRAFTFLEET_ACTOR_ENV_POOL_H_
#define CRAFTFLEET_ACTOR_ENV_POOL_H_

#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "actor/env_client.h"
#include "common/types.h"

namespace craftfleet {

// Games are opened on the reachable server that has fewest of them. When a server fails all games of the pool are
// closed; the caller opens them again, which lands on the servers that are left. Owned by one thread; Cancel may be
// called from any.
class EnvPool {
 public:
  EnvPool(const std::vector<wire::Endpoint>& servers, const v1::SessionHello& hello, int frame_bytes);

  // Opens games (one that is open already begins anew); their observations, uint8[n,H,W,3], go to `frames`.
  //   Unavailable: no server can be reached; names each.   Others as EnvClient. After an error every game is closed.
  absl::Status Open(absl::Span<const EnvClient::Lane> lanes, std::string* frames);

  // The open lanes in the order in which Step wants them: server by server.
  std::vector<int> Arrange(std::vector<int> lanes) const;

  // Steps `lanes`, arranged; rows of `batch` stand in their order. After an error every game is closed.
  absl::Status Step(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot, StepBatch* batch);

  // Ends all sessions, and with them all games.
  void Reset();

  // Ends all sessions for good; from any thread.
  void Cancel();

 private:
  struct Server {
    std::unique_ptr<EnvClient> client;
    absl::Time next_try = absl::InfinitePast();  // to connect
    absl::Duration backoff = absl::ZeroDuration();
    int lanes = 0;
    StepBatch batch;  // reused
  };

  // Connects to servers whose time has come. Unavailable: none is connected.
  absl::Status ConnectServers();
  // Closes those of `lanes` that are open.
  absl::Status CloseOpenOnes(absl::Span<const EnvClient::Lane> lanes);
  // Opens `lanes`, none of them open, on the servers that have fewest.
  absl::Status Spread(absl::Span<const EnvClient::Lane> lanes, std::string* frames);
  size_t LeastLoaded() const;
  absl::Status OpenOn(size_t server, absl::Span<const EnvClient::Lane> lanes, absl::Span<const int> rows,
                      std::string* frames);
  // The rows of `lanes`, arranged, that are on `server`: [first, last).
  std::pair<size_t, size_t> RowsOn(size_t server, absl::Span<const int> lanes) const;
  absl::Status SendAndReceive(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot,
                              StepBatch* batch);

  const int frame_bytes_;
  std::vector<Server> servers_;
  std::map<int, size_t> server_of_;  // index into servers_, by lane
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ENV_POOL_H_
