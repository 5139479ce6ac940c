// The envelope of a game's snapshot: sealing an opened game must restore the same bytes. If the first byte is even, the
// rest is the whole snapshot; otherwise it is a game in a valid envelope.

#include "common/base/check.h"
#include "common/io/snapshot_envelope.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

constexpr uint64_t kEnv = 0x0123456789abcdef;
constexpr uint64_t kOtherEnv = kEnv + 1;

}  // namespace

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const absl::string_view rest = input.substr(1);
  const bool is_game = (input[0] & 1) != 0;
  const std::string sealed = is_game ? SealSnapshot(kEnv, rest) : std::string(rest);
  const auto game = OpenSnapshot(kEnv, sealed);
  CRAFTFLEET_CHECK(CheckSnapshot(kEnv, sealed).ok() == (game.ok() || sealed.empty()));
  if (is_game) CRAFTFLEET_CHECK(game.ok() == (sealed.size() <= kMaxSnapshotBytes));
  if (!game.ok()) {
    CRAFTFLEET_CHECK(game.status().code() == absl::StatusCode::kInvalidArgument);
    return;
  }
  CRAFTFLEET_CHECK(sealed.size() <= kMaxSnapshotBytes);
  CRAFTFLEET_CHECK(SealSnapshot(kEnv, *game) == sealed);
  CRAFTFLEET_CHECK(!OpenSnapshot(kOtherEnv, sealed).ok());
}

std::vector<std::string> SoundInputs() {
  const std::string sealed = SealSnapshot(kEnv, "a game");
  std::string damaged = sealed;
  damaged.back() ^= 1;
  return {'\0' + sealed,
          '\0' + damaged,
          '\0' + sealed.substr(0, sealed.size() - 1),
          '\0' + sealed.substr(0, 12),
          '\0' + SealSnapshot(kOtherEnv, "a game"),
          '\0' + SealSnapshot(kEnv, ""),
          std::string(1, '\0'),
          "\1a game",
          '\1' + std::string(kMaxSnapshotBytes, 'g')};
}

}  // namespace craftfleet
