// The games of one session, by lane.

#pragma once

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
#include <absl/types/span.h>

#include "common/base/types.h"
#include "envserver/game.h"

namespace craftfleet {

// Thread-compatible: one thread at a time.
class EnvBatch {
 public:
  static constexpr int kMaxLanes = 4096;  // games of one session
  // Largest episode number of a new game; snapshots may continue up to 2^52.
  static constexpr int64_t kMaxEpisode = int64_t{1} << 50;
  static constexpr int64_t kMaxMomentBytes = 64 << 20;  // of the moments of all games

  // A game to start, or to continue from a snapshot.
  struct OpenLane {
    int lane = 0;
    int64_t seed = 0;
    int64_t episode = 1;         // of a new game, 1..kMaxEpisode
    absl::string_view snapshot;  // empty: a new game
  };

  // A lane that was not opened because its snapshot is invalid.
  struct Refused {
    int lane = 0;
    std::string reason;
  };

  // Observations are raw, or scene records if `format` says so.
  explicit EnvBatch(std::shared_ptr<const Renderer> renderer, FrameFormat format = FrameFormat::kRaw)
      : renderer_(std::move(renderer)), format_(format) {}

  // Records from now on, which needs raw observations. `larger`, with the games' world options, draws larger pictures;
  // null: none.
  void Record(std::shared_ptr<const Renderer> larger) {
    records_ = true;
    larger_ = std::move(larger);
  }

  // Opens `lanes` (an open one is replaced) and writes their observations, uint8[n,H,W,3] or n records, to `frames`.
  // Lanes with an invalid snapshot are closed: refused() names them, and frames and moments contain the others only.
  //   InvalidArgument: a lane below 0 or named twice, too many lanes, more of them than kMaxMomentBytes allows to
  //   record, or an episode out of range.   Cancelled: see StopWhen.
  absl::Status Open(absl::Span<const OpenLane> lanes, std::string* frames);
  // How many of `lanes` are not open.
  int64_t CountClosed(absl::Span<const OpenLane> lanes) const;

  // Lanes refused by the last Open, in its order.
  const std::vector<Refused>& refused() const { return refused_; }

  // One step of each of `lanes` with its action. An ended game starts its next episode: the row has the result of
  // the last step and the first frame of the new episode. With `snapshot`, the result includes the games' states after
  // the step. Scene records of a step with `snapshot`, and those after it, can be read without those before it.
  //   InvalidArgument: a lane that is not open or named twice; nothing was stepped.   Cancelled: see StopWhen; some
  //   games were stepped, and their results are lost.
  absl::Status Step(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot, StepBatch* batch);

  // In a recording: the moments of the games after the last Open or Step, in its order; for a game that ended, the
  // last moment of the ended episode. The caller may move them out.
  std::vector<Moment>& moments() { return moments_; }

  // Open and Step call `stopped` between games, some times a second, and return Cancelled if it returns true.
  void StopWhen(std::function<bool()> stopped) { stopped_ = std::move(stopped); }

  // Open and Step also call `paused` between games, and return if it returns true. Their results are complete when
  // Resume, called until nothing is left, has returned OK; until then their arguments must not change.
  void PauseWhen(std::function<bool()> paused) { paused_ = std::move(paused); }
  // Whether games of the last Open or Step, which returned OK, are left.
  bool unfinished() const { return next_ < count_; }
  // Goes on with at least one of them. Errors as those of Open and Step.
  absl::Status Resume();

  // Steps of the current episode of an open lane's game.
  int64_t EpisodeSteps(int lane) const { return games_.at(lane).world().step(); }
  bool IsOpen(int lane) const { return games_.count(lane) > 0; }

  // Drops games. Lanes that are not open are ignored.
  void Close(absl::Span<const int> lanes);

  const Renderer& renderer() const { return *renderer_; }
  FrameFormat format() const { return format_; }
  bool records() const { return records_; }
  // Of a recording's larger pictures; 0: none.
  int picture_bytes() const { return larger_ == nullptr ? 0 : larger_->frame_bytes(); }
  int size() const { return static_cast<int>(games_.size()); }
  // The room for objects beyond kUsualObjects, of all games (SessionBytes).
  int64_t more_objects() const { return more_objects_; }

 private:
  absl::Status CheckRoom(int64_t more) const;
  // Cancelled: the result is no longer needed.
  absl::Status CheckStopped();
  // Drops the game of a lane, if it is open.
  void Drop(int lane);
  // DataLoss: the snapshot is invalid.
  absl::Status OpenOne(const OpenLane& lane, absl::Span<uint8_t> frame);
  // One step of a game with pictures; takes its moment if the session records.
  Game::PlayedStep StepAndDraw(Action action, Game* game, absl::Span<uint8_t> frame, StepBatch* batch);
  // Sets `chosen_`.
  absl::Status Find(absl::Span<const int> lanes);
  // Begins a request for `count` games.
  void Begin(size_t count);
  absl::Status OpenNext();
  absl::Status StepNext();

  const std::shared_ptr<const Renderer> renderer_;
  const FrameFormat format_;
  bool records_ = false;
  std::shared_ptr<const Renderer> larger_;  // of a recording
  std::map<int, Game> games_;
  int64_t more_objects_ = 0;
  std::vector<Game*> chosen_;  // the games of the current request, in its order
  // The current request: how many games it has, how many of them are done, and its arguments.
  size_t count_ = 0;
  size_t next_ = 0;
  absl::Span<const OpenLane> to_open_;  // empty: it is a step
  std::string* opened_frames_ = nullptr;
  absl::Span<const Action> actions_;
  bool snapshot_ = false;
  StepBatch* step_ = nullptr;
  std::string picture_;  // not sent, of games that are opened in a session with records
  std::vector<Moment> moments_;
  std::function<bool()> stopped_;
  std::function<bool()> paused_;
  absl::Time next_check_ = absl::InfinitePast();
  std::vector<Refused> refused_;
};

}  // namespace craftfleet
