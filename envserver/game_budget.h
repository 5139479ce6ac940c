// How many games, and how much memory for them, the sessions of an environment server may have.

#ifndef CRAFTFLEET_ENVSERVER_GAME_BUDGET_H_
#define CRAFTFLEET_ENVSERVER_GAME_BUDGET_H_

#include <cstdint>
#include <limits>

#include <absl/status/status.h>

#include "common/mutex.h"

namespace craftfleet {

// What games take: counted, or for memory reckoned before anything is allocated. Thread-safe.
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

  explicit GameBudget(const Options& options) : options_(options) {}

  // What one session has. Gives it back when it goes. Thread-compatible.
  class Share {
   public:
    explicit Share(GameBudget* budget) : budget_(budget) {}
    ~Share() { budget_->Return(games_, bytes_); }
    Share(const Share&) = delete;
    Share& operator=(const Share&) = delete;

    // Has `games` with `bytes` of memory from now on, in place of what it had.
    //   ResourceExhausted, naming what was asked for, the limit and its flag: it keeps what it had.
    absl::Status Set(int64_t games, int64_t bytes);

   private:
    GameBudget* const budget_;
    int64_t games_ = 0;
    int64_t bytes_ = 0;
  };

  int64_t games() const ABSL_LOCKS_EXCLUDED(mu_);
  int64_t bytes() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  absl::Status Take(int64_t had_games, int64_t had_bytes, int64_t games, int64_t bytes) ABSL_LOCKS_EXCLUDED(mu_);
  void Return(int64_t games, int64_t bytes) ABSL_LOCKS_EXCLUDED(mu_);

  const Options options_;
  mutable Mutex mu_;
  int64_t games_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t bytes_ ABSL_GUARDED_BY(mu_) = 0;
};

// Reckons the memory of a session whose games have pictures of `frame_bytes` and are recorded with larger ones of
// `picture_bytes` (0: without). Somewhat more than what it is.
int64_t SessionBytes(int64_t games, int64_t frame_bytes, bool records, int64_t picture_bytes);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_GAME_BUDGET_H_
