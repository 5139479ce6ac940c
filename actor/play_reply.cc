#include "actor/play_reply.h"

#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/str_format.h>
#include <absl/time/time.h>

#include "common/base/crafter.h"
#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/base/types.h"
#include "common/config/env_name.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"

namespace craftfleet {
namespace {

// Requests time out long before; the time that a server reports is only shown on status pages.
constexpr int64_t kMaxBusyNs = int64_t{3600} * 1'000'000'000;

int64_t SizeOf(const std::string& bytes) { return static_cast<int64_t>(bytes.size()); }

int64_t MaxLength(const v1::EnvConfig& env) { return env.length() > 0 ? env.length() : kEpisodeLength; }

uint64_t DigestOf(const v1::EnvConfig& env) {
  const absl::StatusOr<EnvName> name = EnvName::Parse(env.name());
  return name.ok() ? EnvDigest(name->WorldName(), MaxLength(env)) : 0;
}

// Checks the fields that any reply may have.
absl::Status CheckCommon(const v1::PlayReply& reply) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("busy_ns", reply.busy_ns(), 0, kMaxBusyNs));
  // The summary is shown in logs and on status pages, including the learner's.
  return reply.has_server() ? wire::CheckSummary(reply.server()) : absl::OkStatus();
}

// Checks that fields of the reply to hello are empty.
absl::Status CheckNoHello(const v1::PlayReply& reply) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("frame_format", reply.frame_format(), 0, 0));
  const int64_t bytes = SizeOf(reply.program_version()) + SizeOf(reply.canary());
  return wire::CheckSize("program_version and canary", bytes, 0, "bytes after hello");
}

// Checks that fields of the reply to a step are empty.
absl::Status CheckNoStep(const v1::PlayReply& reply) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("rewards", reply.rewards_size(), 0, "numbers"));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("ends", SizeOf(reply.ends()), 0, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("last_frames", SizeOf(reply.last_frames()), 0, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("episodes", reply.episodes_size(), 0, "episodes"));
  return wire::CheckSize("snapshots", reply.snapshots_size(), 0, "snapshots");
}

// Checks that there are neither frames nor lanes.
absl::Status CheckNoGames(const v1::PlayReply& reply) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckNoStep(reply));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("frames", SizeOf(reply.frames()), 0, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("episode_steps", reply.episode_steps_size(), 0, "numbers"));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("moments", reply.moments_size(), 0, "moments"));
  return wire::CheckSize("refused", reply.refused_size(), 0, "lanes");
}

// Only a lane with a snapshot can be refused.
absl::Status CheckRefused(const v1::OpenLanes& request, const v1::PlayReply& reply) {
  int row = 0;
  for (const v1::RefusedLane& refused : reply.refused()) {
    while (row < request.lanes_size() &&
           (request.lanes(row).lane() != refused.lane() || request.lanes(row).snapshot().empty())) {
      ++row;
    }
    if (row++ == request.lanes_size()) {
      return absl::InvalidArgumentError(
          absl::StrFormat("refused: lane %d, want lanes with a snapshot, in the order of the request", refused.lane()));
    }
  }
  return absl::OkStatus();
}

}  // namespace

std::string CutReason(absl::string_view text) { return Printable(text.substr(0, wire::kMaxReasonBytes)); }

PlayReplyCheck::PlayReplyCheck(const v1::SessionHello& hello, int frame_bytes)
    : frame_bytes_(frame_bytes), max_length_(MaxLength(hello.env())), env_digest_(DigestOf(hello.env())) {}

absl::Status PlayReplyCheck::Hello(const v1::PlayReply& reply) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCommon(reply));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("program_version", reply.program_version()));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("canary", reply.canary()));
  return CheckNoGames(reply);
}

absl::Status PlayReplyCheck::Open(const v1::OpenLanes& request, const v1::PlayReply& reply) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCommon(reply));
  CRAFTFLEET_RETURN_IF_ERROR(CheckNoHello(reply));
  CRAFTFLEET_RETURN_IF_ERROR(CheckNoStep(reply));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRefused(request, reply));
  const int64_t open = request.lanes_size() - reply.refused_size();
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("frames", SizeOf(reply.frames()), open * frame_bytes_, "bytes"));
  return EpisodeSteps(reply, open);
}

absl::Status PlayReplyCheck::Step(const v1::StepLanes& request, const v1::PlayReply& reply) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCommon(reply));
  CRAFTFLEET_RETURN_IF_ERROR(CheckNoHello(reply));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("refused", reply.refused_size(), 0, "lanes"));
  const int lanes = request.lanes_size();
  CRAFTFLEET_RETURN_IF_ERROR(EpisodeSteps(reply, lanes));
  CRAFTFLEET_RETURN_IF_ERROR(
      wire::CheckSize("snapshots", reply.snapshots_size(), request.snapshot() ? lanes : 0, "snapshots"));
  // The learner would refuse a fragment with an invalid snapshot.
  for (const std::string& snapshot : reply.snapshots()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckSnapshot(env_digest_, snapshot));
  }
  return absl::OkStatus();
}

absl::Status PlayReplyCheck::Close(const v1::PlayReply& reply) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCommon(reply));
  CRAFTFLEET_RETURN_IF_ERROR(CheckNoHello(reply));
  return CheckNoGames(reply);
}

absl::Status PlayReplyCheck::EpisodeSteps(const v1::PlayReply& reply, int64_t lanes) const {
  if (reply.episode_steps_size() == 0) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckSize("episode_steps", reply.episode_steps_size(), lanes, "numbers"));
  for (const int64_t steps : reply.episode_steps()) {
    CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("episode_steps", steps, 0, max_length_ - 1));
  }
  return absl::OkStatus();
}

absl::Status EpisodeLengths::Open(const v1::OpenLanes& request, const v1::PlayReply& reply) {
  int row = 0;
  int refused = 0;
  for (const v1::OpenLanes::Lane& lane : request.lanes()) {
    if (refused < reply.refused_size() && reply.refused(refused).lane() == lane.lane()) {
      ++refused;
      continue;
    }
    const bool is_new = lane.snapshot().empty();
    const int64_t steps = reply.episode_steps_size() > 0 ? reply.episode_steps(row++) : 0;
    if (is_new && steps != 0) {
      return absl::InvalidArgumentError(
          absl::StrFormat("episode_steps: %d of lane %d, want 0 of a new game", steps, lane.lane()));
    }
    games_[lane.lane()] = {steps, is_new || reply.episode_steps_size() > 0};
  }
  return absl::OkStatus();
}

absl::Status EpisodeLengths::Step(const v1::StepLanes& request, const v1::PlayReply& reply) {
  int ended = 0;
  for (int row = 0; row < request.lanes_size(); ++row) {
    const int lane = request.lanes(row);
    Game& game = games_[lane];
    ++game.steps;
    if (reply.ends()[row] != static_cast<char>(StepEnd::kNone)) {
      const int64_t length = reply.episodes(ended++).length();
      if (length < game.steps || (game.is_whole && length != game.steps)) {
        return absl::InvalidArgumentError(absl::StrFormat("episodes.length: %d of lane %d, want %s%d", length, lane,
                                                          game.is_whole ? "" : "at least ", game.steps));
      }
      game = {0, true};
    } else if (game.steps >= most_) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "ends: the episode of lane %d goes on after %d steps, want at most %d", lane, game.steps, most_));
    }
    if (reply.episode_steps_size() > 0 && game.is_whole && reply.episode_steps(row) != game.steps) {
      return absl::InvalidArgumentError(
          absl::StrFormat("episode_steps: %d of lane %d, want %d", reply.episode_steps(row), lane, game.steps));
    }
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
