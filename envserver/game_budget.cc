#include "envserver/game_budget.h"

#include <algorithm>

#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int64_t kMiB = int64_t{1} << 20;
constexpr int64_t kWorldBytes = 64 << 10;     // per game: its world, its snapshot and the messages with it
constexpr int64_t kObjectBytes = 96;          // per object: in the world, and in the snapshot and its message
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

// `percent` hundredths of a limit, which may be kUnlimited.
int64_t Part(int64_t limit, int percent) { return limit / 100 * percent + limit % 100 * percent / 100; }

bool Exceeds(const GameBudget::Amount& one, const GameBudget::Amount& other) {
  return one.games > other.games || one.bytes > other.bytes;
}

// What `total` becomes if a part of it that was `had` becomes `wanted`.
GameBudget::Amount Changed(const GameBudget::Amount& total, const GameBudget::Amount& had,
                           const GameBudget::Amount& wanted) {
  return {total.games - had.games + wanted.games, total.bytes - had.bytes + wanted.bytes};
}

}  // namespace

absl::Status GameBudget::Options::Validate() const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckLimit("max_session_games", session_games, 1, ""));
  CRAFTFLEET_RETURN_IF_ERROR(CheckLimit("max_games", games, session_games, ", which is --max_session_games"));
  CRAFTFLEET_RETURN_IF_ERROR(CheckLimit("max_session_mb", session_bytes / kMiB, 1, ""));
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckLimit("max_games_mb", bytes / kMiB, session_bytes / kMiB, ", which is --max_session_mb"));
  if (client_percent >= 1 && client_percent <= 100) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("--max_client_percent=%d, want 1..100", client_percent));
}

absl::Status GameBudget::Share::Set(int64_t games, int64_t bytes) {
  const Amount wanted = {games, bytes};
  if (games == amount_.games && bytes == amount_.bytes) return absl::OkStatus();
  if (Exceeds(wanted, amount_)) CRAFTFLEET_RETURN_IF_ERROR(budget_->CheckSession(wanted));
  bool client_is_full = false;
  if (absl::Status status = budget_->Take(client_, amount_, wanted, &client_is_full); !status.ok()) {
    if (budget_->full_ != nullptr) budget_->full_(client_is_full ? &client_ : nullptr);
    return status;
  }
  amount_ = wanted;
  return absl::OkStatus();
}

absl::Status GameBudget::CheckSession(const Amount& wanted) const {
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckRoom("games of one session", wanted.games, options_.session_games, "max_session_games"));
  return CheckMemory("MiB for one session's games", wanted.bytes, options_.session_bytes, "max_session_mb");
}

absl::Status GameBudget::CheckClient(const Amount& wanted) const {
  const int percent = options_.client_percent;
  if (percent == 100) return absl::OkStatus();
  const int64_t games = std::max(options_.session_games, Part(options_.games, percent));
  const int64_t bytes = std::max(options_.session_bytes, Part(options_.bytes, percent));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRoom("games of one client", wanted.games, games, "max_client_percent"));
  return CheckMemory("MiB for one client's games", wanted.bytes, bytes, "max_client_percent");
}

absl::Status GameBudget::CheckAll(const Amount& wanted) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckRoom("games of all sessions", wanted.games, options_.games, "max_games"));
  return CheckMemory("MiB for all games", wanted.bytes, options_.bytes, "max_games_mb");
}

absl::Status GameBudget::Take(const std::string& client, const Amount& had, const Amount& wanted,
                              bool* client_is_full) {
  const MutexLock lock(&mu_);
  if (Exceeds(wanted, had)) {  // a release is never refused
    const auto found = clients_.find(client);
    const absl::Status of_client =
        CheckClient(Changed(found == clients_.end() ? Amount() : found->second, had, wanted));
    *client_is_full = !of_client.ok();
    CRAFTFLEET_RETURN_IF_ERROR(of_client);
    CRAFTFLEET_RETURN_IF_ERROR(CheckAll(Changed(all_, had, wanted)));
  }
  Replace(client, had, wanted);
  return absl::OkStatus();
}

void GameBudget::Return(const std::string& client, const Amount& had) {
  const MutexLock lock(&mu_);
  Replace(client, had, {});
}

void GameBudget::Replace(const std::string& client, const Amount& had, const Amount& wanted) {
  all_ = Changed(all_, had, wanted);
  const auto entry = clients_.try_emplace(client).first;
  entry->second = Changed(entry->second, had, wanted);
  if (entry->second.games == 0 && entry->second.bytes == 0) clients_.erase(entry);
}

int64_t GameBudget::bytes() const {
  const MutexLock lock(&mu_);
  return all_.bytes;
}

int64_t SessionBytes(int64_t games, int64_t more_objects, int64_t frame_bytes, bool records, int64_t picture_bytes) {
  const int64_t moment = records ? kMomentCopies * (frame_bytes + picture_bytes + kMomentBytes) : 0;
  const int64_t game = kWorldBytes + kFrameCopies * frame_bytes + moment;
  return kSessionBytes + kRendererFrames * (frame_bytes + picture_bytes) + games * game + more_objects * kObjectBytes;
}

}  // namespace craftfleet
