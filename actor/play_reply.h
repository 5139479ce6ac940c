// Checks the replies of an environment server; what can be said of a PlayReply by itself is checked when it is read
// (common/wire/convert.h).

#pragma once

#include <cstdint>
#include <string>
#include <unordered_map>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/environment.pb.h"

namespace craftfleet {

// Makes `text` from another process safe to log and forward: printable, at most wire::kMaxReasonBytes.
std::string CutReason(absl::string_view text);

// Checks the replies of one session, whose frames are raw: FrameReader comes first. Errors are InvalidArgument with
// field, value and what was expected. Immutable.
class PlayReplyCheck {
 public:
  // For a session that begins with `hello` and has frames of `frame_bytes` bytes.
  PlayReplyCheck(const v1::SessionHello& hello, int frame_bytes);

  int64_t max_length() const { return max_length_; }  // of an episode, steps

  absl::Status Hello(const v1::PlayReply& reply) const;
  absl::Status Open(const v1::OpenLanes& request, const v1::PlayReply& reply) const;
  absl::Status Step(const v1::StepLanes& request, const v1::PlayReply& reply) const;
  absl::Status Close(const v1::PlayReply& reply) const;

 private:
  absl::Status EpisodeSteps(const v1::PlayReply& reply, int64_t lanes) const;

  const int64_t frame_bytes_;
  const int64_t max_length_;   // steps of an episode
  const uint64_t env_digest_;  // for snapshots
};

// Compares the lengths of a session's episodes with the steps that were played. Thread-compatible: one thread at a
// time.
class EpisodeLengths {
 public:
  // `most`: steps of an episode of the session's environment.
  explicit EpisodeLengths(int64_t most) : most_(most) {}

  // A new session begins.
  void Clear() { games_.clear(); }
  // The games of `request` begin, or go on from snapshots. `reply` has passed PlayReplyCheck.   InvalidArgument: a new
  // game has steps.
  absl::Status Open(const v1::OpenLanes& request, const v1::PlayReply& reply);
  // `reply` has passed PlayReplyCheck and FromProto.   InvalidArgument: a game has other steps than were counted here;
  // an episode has another length than its steps (the learner would refuse its fragment); or one does not end when it
  // has the most steps.
  absl::Status Step(const v1::StepLanes& request, const v1::PlayReply& reply);

 private:
  struct Game {
    int64_t steps = 0;      // of the current episode, or, unless that is whole, of its part in this session
    bool is_whole = false;  // it began here, or the server has told its steps
  };
  const int64_t most_;
  std::unordered_map<int, Game> games_;  // by lane
};

}  // namespace craftfleet
