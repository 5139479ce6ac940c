// Limits the games and their memory, per session and for all sessions of an environment server.

#ifndef CRAFTFLEET_ENVSERVER_GAME_BUDGET_H_
#define CRAFTFLEET_ENVSERVER_GAME_BUDGET_H_

#include <cstdint>
#include <functional>
#include <limits>
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
    // InvalidArgument, naming the flag of craftfleet-envserver.
    absl::Status Validate() const;
  };

  // `full` is called, without locks held, when a share within the limits of a session exceeds those of all together.
  explicit GameBudget(const Options& options, std::function<void()> full = nullptr)
      : options_(options), full_(std::move(full)) {}

  // The share of one session, released on destruction. Thread-compatible.
  class Share {
   public:
    explicit Share(GameBudget* budget) : budget_(budget) {}
    ~Share() { budget_->Return(games_, bytes_); }
    Share(const Share&) = delete;
    Share& operator=(const Share&) = delete;

    // Changes the share to `games` with `bytes` of memory.
    //   ResourceExhausted, naming the request, the limit and its flag: the share is unchanged.
    absl::Status Set(int64_t games, int64_t bytes);

   private:
    GameBudget* const budget_;
    int64_t games_ = 0;
    int64_t bytes_ = 0;
  };

  int64_t games() const ABSL_LOCKS_EXCLUDED(mu_);
  int64_t bytes() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  absl::Status CheckSession(int64_t games, int64_t bytes) const;
  absl::Status Take(int64_t had_games, int64_t had_bytes, int64_t games, int64_t bytes) ABSL_LOCKS_EXCLUDED(mu_);
  void Return(int64_t games, int64_t bytes) ABSL_LOCKS_EXCLUDED(mu_);

  const Options options_;
  const std::function<void()> full_;
  mutable Mutex mu_;
  int64_t games_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t bytes_ ABSL_GUARDED_BY(mu_) = 0;
};

// Estimates the memory of a session whose games have pictures of `frame_bytes` and are recorded with larger ones of
// `picture_bytes` (0: not recorded). The estimate is somewhat too high.
int64_t SessionBytes(int64_t games, int64_t frame_bytes, bool records, int64_t picture_bytes);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_GAME_BUDGET_H_
