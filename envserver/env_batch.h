// The games of one session, by lane.

#ifndef CRAFTFLEET_ENVSERVER_ENV_BATCH_H_
#define CRAFTFLEET_ENVSERVER_ENV_BATCH_H_

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/optional.h>
#include <absl/types/span.h>

#include "common/types.h"
#include "envserver/game.h"
#include "envserver/moment_taker.h"

namespace craftfleet {

// Thread-compatible: one thread at a time.
class EnvBatch {
 public:
  static constexpr int kMaxLanes = 4096;  // games of one session
  // First episode that can be asked for; snapshots count on to 2^52.
  static constexpr int64_t kMaxEpisode = int64_t{1} << 50;
  static constexpr int64_t kMaxMomentBytes = 64 << 20;  // of the moments of all games

  // A game to begin or to go on with.
  struct OpenLane {
    int lane = 0;
    int64_t seed = 0;
    int64_t episode = 1;         // of a new game, 1..kMaxEpisode
    absl::string_view snapshot;  // empty: a new game
  };

  // A lane that was not opened, since its snapshot is no game.
  struct Refused {
    int lane = 0;
    std::string reason;
  };

  explicit EnvBatch(std::shared_ptr<const Renderer> renderer, absl::optional<MomentTaker> recording = absl::nullopt)
      : renderer_(std::move(renderer)), recording_(std::move(recording)) {}

  // Opens `lanes` (one that is open already starts anew) and writes their observations, uint8[n,H,W,3], to `frames`.
  // Those whose snapshot is not of such a game are closed: refused() names them, and frames and moments have the rest.
  //   InvalidArgument: a lane below 0, too many lanes, more of them than kMaxMomentBytes allows to record, or an
  //   episode out of range.   Cancelled: see StopWhen.
  absl::Status Open(absl::Span<const OpenLane> lanes, std::string* frames);

  // Of the last Open, in its order.
  const std::vector<Refused>& refused() const { return refused_; }

  // One step of each of `lanes` with its action. An ended game goes on with its next episode: the row has the result of
  // the last step and the first frame of the new episode. With `snapshot` the games' states after the step are given
  // too.
  //   InvalidArgument: a lane that is not open or named twice; nothing was stepped.   Cancelled: see StopWhen; some
  //   games were stepped, and their results are lost.
  absl::Status Step(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot, StepBatch* batch);

  // With `recording`: what the games of the last Open or Step looked like after it, in its order; of a game that ended,
  // the last moment of the episode that ended. May be taken away.
  std::vector<Moment>& moments() { return moments_; }

  // Open and Step ask `stopped` between games, some times a second, and end with Cancelled when it says so.
  void StopWhen(std::function<bool()> stopped) { stopped_ = std::move(stopped); }

  // Drops games. Lanes that are not open are ignored.
  void Close(absl::Span<const int> lanes);

  const Renderer& renderer() const { return *renderer_; }
  bool records() const { return recording_.has_value(); }
  // Of a recording's larger pictures; 0: none.
  int picture_bytes() const { return recording_.has_value() ? recording_->picture_bytes() : 0; }
  int size() const { return static_cast<int>(games_.size()); }

 private:
  absl::Status CheckRoom(size_t more) const;
  // Cancelled: nobody waits for the rest.
  absl::Status CheckStopped();
  // DataLoss: the snapshot.
  absl::Status OpenOne(const OpenLane& lane, absl::Span<uint8_t> frame);
  // Sets `chosen_`.
  absl::Status Find(absl::Span<const int> lanes);

  const std::shared_ptr<const Renderer> renderer_;
  const absl::optional<MomentTaker> recording_;
  std::map<int, Game> games_;
  std::vector<Game*> chosen_;  // the games of the current request, in its order
  std::vector<Moment> moments_;
  std::function<bool()> stopped_;
  absl::Time next_look_ = absl::InfinitePast();
  std::vector<Refused> refused_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_ENV_BATCH_H_
