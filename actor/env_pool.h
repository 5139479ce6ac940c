// The games of one loop, spread over environment servers.

#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "actor/env_client.h"
#include "actor/env_connections.h"
#include "actor/env_directory.h"
#include "actor/env_server_tracker.h"
#include "actor/lane_placement.h"
#include "actor/server_health.h"
#include "common/base/types.h"

namespace craftfleet {

// Opens each game on the server with the fewest games (LanePlacement) among those that can be reached and answer
// (EnvConnections). When a server fails, its games are closed and the others stay open. Each call returns the lanes
// lost in this way; the caller opens them again, on the remaining servers. Refresh adapts to servers that come and go.
// A server's error makes a call fail only if there is no other server (error_policy.h). Owned by one thread; Cancel may
// be called from any.
class EnvPool {
 public:
  // The result of opening a lane.
  struct OpenedLane {
    int lane = 0;
    std::string frame = {};    // uint8[H,W,3]: its observation
    std::string record = {};   // the scene record of it, if the server sends these (EnvClient::records)
    std::string refusal = {};  // why two servers, or the only one, refused its snapshot; empty: opened
  };
  struct Opened {
    std::vector<OpenedLane> lanes;  // in the order of the request
    std::vector<int> lost;          // lanes whose server failed in the meantime, possibly just opened
  };

  // The result of a step of one lane.
  struct SteppedLane {
    int lane = 0;
    float reward = 0;
    StepEnd end = StepEnd::kNone;
    Episode episode;         // set if `end` is not kNone
    std::string last_frame;  // uint8[H,W,3]: the last frame of a truncated episode, else empty
    std::string snapshot;    // after the step, if requested
    std::string record;      // of the next observation, if the server sends scene records (EnvClient::records)
  };
  struct Stepped {
    std::vector<SteppedLane> lanes;  // in the order of the request, without `lost`
    std::string
        frames;  // uint8[n,H,W,3], in the order of `lanes`: the next observations; after an end, of the new episode
    std::vector<int> lost;
    absl::Duration busy;  // work time of the slowest server
  };

  // `first`: the preferred one of equally loaded servers (LanePlacement). `health` is shared by all pools with the same
  // servers; null: there is no other pool.
  EnvPool(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes, size_t first = 0,
          std::shared_ptr<ServerHealth> health = nullptr);

  // Adapts to the directory: adds new servers, drops those that are gone or do not answer, and closes games if a server
  // has at least two more than another. Returns the lanes that were closed; the caller opens them again. Never waits
  // for a connection.
  std::vector<int> Refresh();

  // Opens games; one that is already open is replaced. If a server fails or refuses a snapshot, another is tried.
  //   Unavailable: no server can be reached or answers; lists them.   Cancelled: Cancel was called.
  //   Others: the error of the first server, if the directory is fixed and every server is unfit.
  // After an error, every game is closed.
  absl::StatusOr<Opened> Open(absl::Span<const EnvClient::Lane> lanes);

  // Closes those of `lanes` that are open. Returns the lanes that were lost. After an error every game is closed.
  absl::StatusOr<std::vector<int>> Close(absl::Span<const int> lanes);

  // Orders open lanes as Step requires: server by server.
  std::vector<int> Arrange(std::vector<int> lanes) const { return placement_.Arrange(std::move(lanes)); }

  // Plays one step of `lanes`, which are in the order of Arrange.
  //   Unavailable: all lanes are lost; gives the reason.   Cancelled: Cancel was called, and every game is closed.
  absl::StatusOr<Stepped> Step(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot);

  // The state of each server.
  std::vector<EnvServerTracker::Server> Report() const;

  // Ends all sessions, and with them all games.
  void Reset();

  // Ends all sessions for good. May be called from any thread.
  void Cancel() { connections_.Cancel(); }

 private:
  // A snapshot that one server refused.
  struct Refusal {
    size_t server = 0;
    std::string reason;
  };
  // A call of Open in progress.
  struct Opening {
    absl::Span<const EnvClient::Lane> lanes;
    Opened result;
    std::vector<size_t> rows;            // indices in `lanes` still to be opened
    std::map<size_t, Refusal> refusals;  // by row; to be tried on a second server
  };

  // Tells the placement which servers have a session.
  void UpdateAvailability();
  // Connects to servers, waiting if necessary. Errors as Open.
  absl::Status ConnectAny();
  // Drops servers that became suspect. Like all functions below, adds their lanes to `lost`.
  absl::Status DropSuspects(std::vector<int>* lost);
  // Ends the session with a server that failed.   Cancelled: Cancel was called.
  absl::Status Lose(size_t server, const absl::Status& why, std::vector<int>* lost);
  absl::Status CloseOpenOnes(absl::Span<const int> lanes, std::vector<int>* lost);
  // Opens the rows of `opening`, none of which is open, on the servers with the fewest games. Rows whose server failed
  // or refused them remain in it.
  absl::Status Spread(Opening* opening);
  // Opens `rows`, which are placed on `server`. Returns the reasons of those that it refused, by row.
  absl::StatusOr<std::map<size_t, std::string>> OpenOn(size_t server, const std::vector<size_t>& rows,
                                                       Opening* opening);
  // Schedules the lanes that `server` refused for another server, or gives up on them.
  void HandleRefusals(size_t server, const std::map<size_t, std::string>& reasons, Opening* opening);
  // `server` has opened some of `rows`: servers that refused one of these become suspect.
  absl::Status BlameRefusals(size_t server, const std::vector<size_t>& rows, Opening* opening);
  absl::StatusOr<Stepped> SendAndReceive(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot);
  // Appends the reply of one server, which stepped `lanes`; it may have no records.
  void Append(absl::Span<const int> lanes, StepBatch* batch, std::vector<std::string>* records, Stepped* stepped) const;

  const int frame_bytes_;
  EnvConnections connections_;
  LanePlacement placement_;
  std::vector<StepBatch> batches_;  // of the last step, by server; reused
};

}  // namespace craftfleet
