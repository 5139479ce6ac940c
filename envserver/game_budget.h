// Limits the games and their memory, per session, per client and for all sessions of an environment server.

#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include <absl/status/status.h>

#include "common/base/mutex.h"

namespace craftfleet {

// Counts games and estimates their memory before anything is allocated. Thread-safe.
class GameBudget {
 public:
  static constexpr int64_t kUnlimited = std::numeric_limits<int64_t>::max();

  struct Options {
    int64_t session_games = kUnlimited;  // of one session, at least 1
    int64_t games = kUnlimited;          // of all together, at least session_games
    int64_t session_bytes = kUnlimited;  // memory of one session, at least 1 MiB
    int64_t bytes = kUnlimited;          // of all together, at least session_bytes
    // The part of `games` and of `bytes` that the sessions of one client may have together, 1..100; they may always
    // have as much as one session.
    int client_percent = 100;
    // InvalidArgument, naming the flag of craftfleet-envserver.
    absl::Status Validate() const;
  };

  // Called, without locks held, when a share within the limits of a session exceeds those of its client, whose name it
  // is given, or those of all together (null).
  using Full = std::function<void(const std::string* client)>;
  explicit GameBudget(const Options& options, Full full = nullptr) : options_(options), full_(std::move(full)) {}

  // Games and bytes that somebody has.
  struct Amount {
    int64_t games = 0;
    int64_t bytes = 0;
  };

  // The share of one session of `client`, released on destruction. Thread-compatible.
  class Share {
   public:
    Share(GameBudget* budget, std::string client) : budget_(budget), client_(std::move(client)) {}
    ~Share() { budget_->Return(client_, amount_); }
    Share(const Share&) = delete;
    Share& operator=(const Share&) = delete;

    // Changes the share to `games` with `bytes` of memory. Cheap if nothing changes.
    //   ResourceExhausted, naming the request, the limit and its flag: the share is unchanged.
    absl::Status Set(int64_t games, int64_t bytes);
    const std::string& client() const { return client_; }
    int64_t bytes() const { return amount_.bytes; }

   private:
    GameBudget* const budget_;
    const std::string client_;
    Amount amount_;
  };

  // Bytes of all shares.
  int64_t bytes() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  absl::Status CheckSession(const Amount& wanted) const;
  absl::Status CheckClient(const Amount& wanted) const;
  absl::Status CheckAll(const Amount& wanted) const;
  // Changes what a session of `client` has. On errors it is unchanged, and `client_is_full` whether the client's limits
  // are the reason.
  absl::Status Take(const std::string& client, const Amount& had, const Amount& wanted, bool* client_is_full)
      ABSL_LOCKS_EXCLUDED(mu_);
  void Return(const std::string& client, const Amount& had) ABSL_LOCKS_EXCLUDED(mu_);
  void Replace(const std::string& client, const Amount& had, const Amount& wanted) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  const Full full_;
  mutable Mutex mu_;
  Amount all_ ABSL_GUARDED_BY(mu_);
  std::map<std::string, Amount> clients_ ABSL_GUARDED_BY(mu_);  // those that have something
};

// The room for objects (World::object_room) that is counted with each game. Play leaves it at that; a crafted snapshot,
// or a player that only plants, may fill all cells.
inline constexpr int64_t kUsualObjects = 256;

// Estimates the memory of a session whose games have pictures of `frame_bytes` and are recorded with larger ones of
// `picture_bytes` (0: not recorded). `more_objects`: the room beyond kUsualObjects, of all games. The estimate is
// somewhat too high.
int64_t SessionBytes(int64_t games, int64_t more_objects, int64_t frame_bytes, bool records, int64_t picture_bytes);

}  // namespace craftfleet
