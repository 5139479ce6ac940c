#include "learner/service/fragment_intake.h"

#include <string>
#include <utility>
#include <vector>

#include <absl/base/casts.h>
#include <absl/hash/hash.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/wire/fragment_check.h"
#include "common/wire/request_check.h"
#include "common/wire/status_service.h"

namespace craftfleet {
namespace {

v1::FragmentVerdict::Verdict VerdictToProto(LaneScheduler::Verdict verdict) {
  switch (verdict) {
    case LaneScheduler::Verdict::kAccepted:
      return v1::FragmentVerdict::ACCEPTED;
    case LaneScheduler::Verdict::kDuplicate:
      return v1::FragmentVerdict::DUPLICATE;
    case LaneScheduler::Verdict::kExpired:
    case LaneScheduler::Verdict::kStale:
      return v1::FragmentVerdict::EXPIRED;
  }
  return v1::FragmentVerdict::VERDICT_UNSPECIFIED;
}

// For exact comparison: as numbers, -0 and 0 are equal.
template <typename T>
absl::string_view BytesOf(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

}  // namespace

uint64_t FragmentDigest(const Fragment& fragment) {
  uint64_t digest = absl::HashOf(fragment.lane, fragment.number, fragment.policy_version, fragment.frames,
                                 fragment.actions, BytesOf(fragment.log_probs), BytesOf(fragment.values),
                                 BytesOf(fragment.rewards), BytesOf(fragment.ends), BytesOf(fragment.truncation_values),
                                 absl::bit_cast<uint32_t>(fragment.bootstrap_value), BytesOf(fragment.states),
                                 fragment.snapshot.game, BytesOf(fragment.snapshot.state));
  for (const Episode& episode : fragment.episodes) {
    digest = absl::HashOf(digest, episode.step, episode.length, absl::bit_cast<uint64_t>(episode.reward),
                          episode.achievements);
  }
  return digest;
}

absl::StatusOr<v1::FragmentVerdict> FragmentIntake::Receive(const WorkerClient& client, v1::FragmentMessage* message) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckName("actor", message->actor()));
  v1::FragmentVerdict verdict;
  verdict.set_lane(message->lane());
  verdict.set_number(message->number());
  const absl::StatusOr<v1::FragmentVerdict::Verdict> given = Take(client, message);
  if (given.status().code() == absl::StatusCode::kInvalidArgument) {
    ++rejected_;
    verdict.set_verdict(v1::FragmentVerdict::REFUSED);
    const std::string refused = Printable(absl::StrFormat("fragment %d of lane %d of actor %s: %s", message->number(),
                                                          message->lane(), message->actor(), given.status().message()));
    verdict.set_reason(refused.substr(0, wire::kMaxReasonBytes));
    return verdict;
  }
  if (!given.ok()) return given.status();
  verdict.set_verdict(*given);
  return verdict;
}

absl::StatusOr<LaneScheduler::Verdict> FragmentIntake::Judge(const WorkerClient& client,
                                                             const v1::FragmentMessage& message) const {
  if (message.epoch() != epoch_) return LaneScheduler::Verdict::kExpired;
  if (message.lane() < 0 || message.lane() >= shape_.lanes) {
    return absl::InvalidArgumentError(absl::StrFormat("lane %d, want 0..%d", message.lane(), shape_.lanes - 1));
  }
  return parts_.registry->Judge(client, message.actor(), {message.lane(), message.number(), message.policy_version()});
}

absl::StatusOr<v1::FragmentVerdict::Verdict> FragmentIntake::Take(const WorkerClient& client,
                                                                  v1::FragmentMessage* message) {
  // Before any work on its content.
  CRAFTFLEET_ASSIGN_OR_RETURN(const LaneScheduler::Verdict judged, Judge(client, *message));
  if (judged == LaneScheduler::Verdict::kExpired) {
    ++expired_;
    return v1::FragmentVerdict::EXPIRED;
  }
  std::string scenes = message->frame_format() == v1::FRAMES_SCENE ? message->frames() : "";
  CRAFTFLEET_RETURN_IF_ERROR(parts_.frames->Draw(shape_.steps, message));
  CRAFTFLEET_ASSIGN_OR_RETURN(Fragment fragment, wire::FromProto(message, shape_));
  if (const WeightStore::Weights played = parts_.weights->Find(fragment.policy_version);
      played.version == fragment.policy_version) {
    CRAFTFLEET_RETURN_IF_ERROR(
        wire::CheckValues(*message, static_cast<float>(played.values.low), static_cast<float>(played.values.high)));
  }
  fragment.scenes = std::move(scenes);
  fragment.sender = message->actor();
  fragment.digest = FragmentDigest(fragment);
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const LaneScheduler::Verdict verdict,
      parts_.registry->Accept(fragment.sender, {fragment.lane, fragment.number, fragment.policy_version},
                              fragment.snapshot, fragment.digest));
  if (verdict == LaneScheduler::Verdict::kAccepted) {
    ++accepted_;
    CRAFTFLEET_RETURN_IF_ERROR(parts_.fragments->Push(std::move(fragment)));  // never full: room for all permits
  } else if (verdict != LaneScheduler::Verdict::kStale) {                     // which LaneCounters has
    ++(verdict == LaneScheduler::Verdict::kDuplicate ? duplicates_ : expired_);
  }
  return VerdictToProto(verdict);
}

void FragmentIntake::AddMetrics(v1::StatusReply* reply) const {
  wire::AddMetric("fragments_accepted", static_cast<double>(accepted_.load()), reply);
  wire::AddMetric("fragments_duplicate", static_cast<double>(duplicates_.load()), reply);
  wire::AddMetric("fragments_expired", static_cast<double>(expired_.load()), reply);
  wire::AddMetric("fragments_rejected", static_cast<double>(rejected_.load()), reply);
  wire::AddMetric("fragments_queued", static_cast<double>(parts_.fragments->size()), reply);
}

}  // namespace craftfleet
