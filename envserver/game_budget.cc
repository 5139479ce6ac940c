#include "envserver/game_budget.h"

#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int64_t kMiB = int64_t{1} << 20;
constexpr int64_t kWorldBytes = 64 << 10;     // per game: its world, its snapshot and the messages with it
constexpr int64_t kMomentBytes = 16 << 10;    // per recorded game, in addition to its pictures
constexpr int64_t kSessionBytes = 256 << 10;  // per session without games: stream, buffers, the renderer's tables
constexpr int64_t kFrameCopies = 4;     // in the reply and its message, for the last pictures of episodes once more
constexpr int64_t kMomentCopies = 2;    // taken, and in the message
constexpr int64_t kRendererFrames = 8;  // tables of light and sprites, in pictures of their size

absl::Status CheckLimit(absl::string_view flag, int64_t value, int64_t least, absl::string_view why) {
  if (value >= least) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("--%s=%d, want at least %d%s", flag, value, least, why));
}

absl::Status CheckRoom(absl::string_view what, int64_t asked, int64_t limit, absl::string_view flag) {
  if (asked <= limit) return absl::OkStatus();
  return absl::ResourceExhaustedError(absl::StrFormat(
      "%s: %d requested, at most %d (--%s): request less, or use another server", what, asked, limit, flag));
}

int64_t RoundedUpMiB(int64_t bytes) { return bytes / kMiB + (bytes % kMiB != 0 ? 1 : 0); }

absl::Status CheckMemory(absl::string_view what, int64_t asked, int64_t limit, absl::string_view flag) {
  if (asked <= limit) return absl::OkStatus();
  return CheckRoom(what, RoundedUpMiB(asked), limit / kMiB, flag);
}

}  // namespace

absl::Status GameBudget::Options::Validate() const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckLimit("max_session_games", session_games, 1, ""));
  CRAFTFLEET_RETURN_IF_ERROR(CheckLimit("max_games", games, session_games, ", which is --max_session_games"));
  CRAFTFLEET_RETURN_IF_ERROR(CheckLimit("max_session_mb", session_bytes / kMiB, 1, ""));
  return CheckLimit("max_games_mb", bytes / kMiB, session_bytes / kMiB, ", which is --max_session_mb");
}

absl::Status GameBudget::Share::Set(int64_t games, int64_t bytes) {
  // A release is never refused.
  if (games > games_ || bytes > bytes_) CRAFTFLEET_RETURN_IF_ERROR(budget_->CheckSession(games, bytes));
  if (absl::Status status = budget_->Take(games_, bytes_, games, bytes); !status.ok()) {
    if (budget_->full_ != nullptr) budget_->full_();
    return status;
  }
  games_ = games;
  bytes_ = bytes;
  return absl::OkStatus();
}

absl::Status GameBudget::CheckSession(int64_t games, int64_t bytes) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckRoom("games of one session", games, options_.session_games, "max_session_games"));
  return CheckMemory("MiB for one session's games", bytes, options_.session_bytes, "max_session_mb");
}

absl::Status GameBudget::Take(int64_t had_games, int64_t had_bytes, int64_t games, int64_t bytes) {
  const MutexLock lock(&mu_);
  const int64_t all_games = games_ - had_games + games;
  const int64_t all_bytes = bytes_ - had_bytes + bytes;
  if (games > had_games || bytes > had_bytes) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckRoom("games of all sessions", all_games, options_.games, "max_games"));
    CRAFTFLEET_RETURN_IF_ERROR(CheckMemory("MiB for all games", all_bytes, options_.bytes, "max_games_mb"));
  }
  games_ = all_games;
  bytes_ = all_bytes;
  return absl::OkStatus();
}

void GameBudget::Return(int64_t games, int64_t bytes) {
  const MutexLock lock(&mu_);
  games_ -= games;
  bytes_ -= bytes;
}

int64_t GameBudget::games() const {
  const MutexLock lock(&mu_);
  return games_;
}

int64_t GameBudget::bytes() const {
  const MutexLock lock(&mu_);
  return bytes_;
}

int64_t SessionBytes(int64_t games, int64_t frame_bytes, bool records, int64_t picture_bytes) {
  const int64_t moment = records ? kMomentCopies * (frame_bytes + picture_bytes + kMomentBytes) : 0;
  const int64_t game = kWorldBytes + kFrameCopies * frame_bytes + moment;
  return kSessionBytes + kRendererFrames * (frame_bytes + picture_bytes) + games * game;
}

}  // namespace craftfleet
