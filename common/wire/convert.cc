#include "common/wire/convert.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/request_check.h"

namespace craftfleet::wire {
namespace {

constexpr int kMaxItemCount = 9;
constexpr int kMaxUnlocks = std::numeric_limits<int32_t>::max();

// Checks that `values` has `wanted` finite numbers, and copies them.
absl::Status ReadFloats(absl::string_view field, const google::protobuf::RepeatedField<float>& values, int wanted,
                        std::vector<float>* out) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize(field, values.size(), wanted, "numbers"));
  for (const float value : values) {
    if (!std::isfinite(value))
      return absl::InvalidArgumentError(absl::StrFormat("%s: holds %f, want finite numbers", field, value));
  }
  out->assign(values.begin(), values.end());
  return absl::OkStatus();
}

absl::Status ReadEnds(absl::string_view bytes, int wanted, std::vector<StepEnd>* ends) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("ends", static_cast<int64_t>(bytes.size()), wanted, "bytes"));
  ends->resize(bytes.size());
  for (size_t i = 0; i < bytes.size(); ++i) {
    const int end = static_cast<unsigned char>(bytes[i]);
    if (end > 2) return absl::InvalidArgumentError(absl::StrFormat("ends: %d at %d, want 0..2", end, i));
    (*ends)[i] = static_cast<StepEnd>(end);
  }
  return absl::OkStatus();
}

std::string EndsToBytes(const std::vector<StepEnd>& ends) {
  return {reinterpret_cast<const char*>(ends.data()), ends.size()};
}

absl::Status CheckActions(absl::string_view actions) {
  for (size_t i = 0; i < actions.size(); ++i) {
    const int action = static_cast<unsigned char>(actions[i]);
    if (action >= kNumActions) {
      return absl::InvalidArgumentError(absl::StrFormat("action %d at %d, want 0..%d", action, i, kNumActions - 1));
    }
  }
  return absl::OkStatus();
}

void EpisodesToProto(const std::vector<Episode>& episodes,
                     google::protobuf::RepeatedPtrField<v1::EpisodeMessage>* out) {
  out->Clear();
  for (const Episode& episode : episodes) {
    v1::EpisodeMessage* message = out->Add();
    message->set_step(episode.step);
    message->set_length(episode.length);
    message->set_reward(episode.reward);
    message->mutable_achievements()->Assign(episode.achievements.begin(), episode.achievements.end());
  }
}

// Checks that each of `counts` is in 0..`highest` and that their number fits `out`, and copies them.
template <size_t kCount>
absl::Status ReadCounts(absl::string_view field, const google::protobuf::RepeatedField<int32_t>& counts, int highest,
                        std::array<int32_t, kCount>* out) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize(field, counts.size(), kCount, "counts"));
  for (const int32_t count : counts) {
    if (count < 0 || count > highest) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "%s: %d, want %s", field, count, highest == kMaxUnlocks ? "at least 0" : absl::StrFormat("0..%d", highest)));
    }
  }
  std::copy(counts.begin(), counts.end(), out->begin());
  return absl::OkStatus();
}

absl::Status ReadEpisode(const v1::EpisodeMessage& message, int step, Episode* episode) {
  if (message.step() != step) {
    return absl::InvalidArgumentError(
        absl::StrFormat("episodes: step %d, want step %d, where it ended", message.step(), step));
  }
  CRAFTFLEET_RETURN_IF_ERROR(ReadCounts("achievements", message.achievements(), kMaxUnlocks, &episode->achievements));
  episode->step = message.step();
  episode->length = message.length();
  episode->reward = message.reward();
  return absl::OkStatus();
}

// Reads one episode for each of `end_steps`, the steps at which one ended, in order.
absl::Status ReadEpisodes(const google::protobuf::RepeatedPtrField<v1::EpisodeMessage>& messages,
                          const std::vector<int>& end_steps, std::vector<Episode>* episodes) {
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckSize("episodes", messages.size(), static_cast<int64_t>(end_steps.size()), "episodes"));
  episodes->resize(end_steps.size());
  for (int i = 0; i < messages.size(); ++i) {
    CRAFTFLEET_RETURN_IF_ERROR(ReadEpisode(messages[i], end_steps[i], &(*episodes)[i]));
  }
  return absl::OkStatus();
}

// The steps of a fragment at which an episode ended.
std::vector<int> EndSteps(const std::vector<StepEnd>& ends) {
  std::vector<int> steps;
  for (size_t t = 0; t < ends.size(); ++t) {
    if (ends[t] != StepEnd::kNone) steps.push_back(static_cast<int>(t));
  }
  return steps;
}

absl::Status ReadMoment(v1::Moment* message, int frame_bytes, int picture_bytes, Moment* moment) {
  const auto size_of = [](const std::string& bytes) { return static_cast<int64_t>(bytes.size()); };
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("moment.frame", size_of(message->frame()), frame_bytes, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("moment.picture", size_of(message->picture()), picture_bytes, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckSize("moment.semantic", size_of(message->semantic()), kWorldSize * kWorldSize, "bytes"));
  const auto known = [](char id) { return id >= 1 && id <= 18; };
  if (!std::all_of(message->semantic().begin(), message->semantic().end(), known)) {
    return absl::InvalidArgumentError("moment.semantic: a cell that is neither a material nor an object, want 1..18");
  }
  const auto inside = [](int32_t cell) { return cell >= 0 && cell < kWorldSize; };
  if (!inside(message->player_x()) || !inside(message->player_y())) {
    return absl::InvalidArgumentError(absl::StrFormat("moment.player: at %d, %d, want 0..%d", message->player_x(),
                                                      message->player_y(), kWorldSize - 1));
  }
  CRAFTFLEET_RETURN_IF_ERROR(ReadCounts("moment.inventory", message->inventory(), kMaxItemCount, &moment->inventory));
  CRAFTFLEET_RETURN_IF_ERROR(
      ReadCounts("moment.achievements", message->achievements(), kMaxUnlocks, &moment->achievements));
  moment->player_x = message->player_x();
  moment->player_y = message->player_y();
  moment->frame = std::move(*message->mutable_frame());
  moment->picture = std::move(*message->mutable_picture());
  moment->semantic = std::move(*message->mutable_semantic());
  return absl::OkStatus();
}

// There must be none, or one for each of `lanes` lanes, within the size limit. The learner checks their content.
absl::Status CheckSnapshots(const google::protobuf::RepeatedPtrField<std::string>& snapshots, int lanes) {
  if (snapshots.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("snapshots", snapshots.size(), lanes, "snapshots"));
  for (const std::string& snapshot : snapshots) {
    if (!snapshot.empty() && snapshot.size() <= kMaxSnapshotBytes) continue;
    return absl::InvalidArgumentError(
        absl::StrFormat("snapshots: one of %d bytes, want 1..%d", snapshot.size(), kMaxSnapshotBytes));
  }
  return absl::OkStatus();
}

int CountTruncated(const std::vector<StepEnd>& ends) {
  return static_cast<int>(std::count(ends.begin(), ends.end(), StepEnd::kTruncated));
}

}  // namespace

v1::FragmentMessage ToProto(Fragment fragment) {
  v1::FragmentMessage message = ToProtoWithoutFrames(fragment);
  *message.mutable_frames() = std::move(fragment.frames);
  message.set_frame_format(static_cast<v1::FrameFormat>(fragment.frame_format));
  return message;
}

v1::FragmentMessage ToProtoWithoutFrames(const Fragment& fragment) {
  v1::FragmentMessage message;
  message.set_epoch(fragment.epoch);
  message.set_lane(fragment.lane);
  message.set_number(fragment.number);
  message.set_policy_version(fragment.policy_version);
  message.set_actions(fragment.actions);
  message.mutable_log_probs()->Assign(fragment.log_probs.begin(), fragment.log_probs.end());
  message.mutable_values()->Assign(fragment.values.begin(), fragment.values.end());
  message.mutable_rewards()->Assign(fragment.rewards.begin(), fragment.rewards.end());
  message.set_ends(EndsToBytes(fragment.ends));
  message.mutable_truncation_values()->Assign(fragment.truncation_values.begin(), fragment.truncation_values.end());
  message.set_bootstrap_value(fragment.bootstrap_value);
  EpisodesToProto(fragment.episodes, message.mutable_episodes());
  message.mutable_states()->Assign(fragment.states.begin(), fragment.states.end());
  message.set_snapshot(fragment.snapshot.game);
  message.mutable_last_state()->Assign(fragment.snapshot.state.begin(), fragment.snapshot.state.end());
  return message;
}

absl::StatusOr<Fragment> FromProto(v1::FragmentMessage* message, const FragmentShape& shape) {
  Fragment fragment;
  if (message->lane() < 0 || message->lane() >= shape.lanes) {
    return absl::InvalidArgumentError(absl::StrFormat("lane %d, want 0..%d", message->lane(), shape.lanes - 1));
  }
  fragment.epoch = message->epoch();
  fragment.lane = message->lane();
  fragment.number = message->number();
  fragment.policy_version = message->policy_version();
  if (message->frame_format() != v1::FRAMES_RAW) {
    return absl::InvalidArgumentError(absl::StrFormat("frame_format: %d, want raw, 0", message->frame_format()));
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("frames", static_cast<int64_t>(message->frames().size()),
                                       static_cast<int64_t>(shape.steps) * shape.frame_bytes, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckSize("actions", static_cast<int64_t>(message->actions().size()), shape.steps, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(CheckActions(message->actions()));
  CRAFTFLEET_RETURN_IF_ERROR(ReadFloats("log_probs", message->log_probs(), shape.steps, &fragment.log_probs));
  CRAFTFLEET_RETURN_IF_ERROR(ReadFloats("values", message->values(), shape.steps, &fragment.values));
  CRAFTFLEET_RETURN_IF_ERROR(ReadFloats("rewards", message->rewards(), shape.steps, &fragment.rewards));
  CRAFTFLEET_RETURN_IF_ERROR(ReadEnds(message->ends(), shape.steps, &fragment.ends));
  CRAFTFLEET_RETURN_IF_ERROR(ReadFloats("truncation_values", message->truncation_values(),
                                        CountTruncated(fragment.ends), &fragment.truncation_values));
  fragment.bootstrap_value = message->bootstrap_value();
  CRAFTFLEET_RETURN_IF_ERROR(ReadEpisodes(message->episodes(), EndSteps(fragment.ends), &fragment.episodes));
  CRAFTFLEET_RETURN_IF_ERROR(
      ReadFloats("states", message->states(), shape.states * shape.state_size, &fragment.states));
  CRAFTFLEET_RETURN_IF_ERROR(
      ReadFloats("last_state", message->last_state(), shape.state_size, &fragment.snapshot.state));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFragmentValues(*message, shape));
  CRAFTFLEET_RETURN_IF_ERROR(CheckEpisodes(message->episodes(), shape.max_length));
  fragment.frames = std::move(*message->mutable_frames());
  fragment.actions = std::move(*message->mutable_actions());
  fragment.snapshot.game = std::move(*message->mutable_snapshot());
  return fragment;
}

v1::SnapshotReply ToProto(LaneSnapshot snapshot) {
  v1::SnapshotReply message;
  *message.mutable_snapshot() = std::move(snapshot.game);
  message.mutable_state()->Assign(snapshot.state.begin(), snapshot.state.end());
  return message;
}

absl::StatusOr<LaneSnapshot> FromProto(v1::SnapshotReply* message, int state_size) {
  LaneSnapshot snapshot;
  CRAFTFLEET_RETURN_IF_ERROR(ReadFloats("state", message->state(), state_size, &snapshot.state));
  snapshot.game = std::move(*message->mutable_snapshot());
  return snapshot;
}

v1::EvaluationResult ToProto(const std::vector<Episode>& episodes) {
  v1::EvaluationResult message;
  EpisodesToProto(episodes, message.mutable_episodes());
  for (v1::EpisodeMessage& episode : *message.mutable_episodes()) episode.set_step(0);
  return message;
}

absl::StatusOr<std::vector<Episode>> FromProto(const v1::EvaluationResult& message, int64_t max_length) {
  std::vector<Episode> episodes;
  for (const v1::EpisodeMessage& episode : message.episodes()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckEpisode(episode, 1, max_length));
  }
  CRAFTFLEET_RETURN_IF_ERROR(ReadEpisodes(message.episodes(), std::vector<int>(message.episodes_size(), 0), &episodes));
  return episodes;
}

void ToProto(StepBatch* batch, v1::PlayReply* message) {
  message->mutable_frames()->swap(batch->frames);
  message->mutable_last_frames()->swap(batch->last_frames);
  message->mutable_rewards()->Assign(batch->rewards.begin(), batch->rewards.end());
  message->mutable_ends()->assign(reinterpret_cast<const char*>(batch->ends.data()), batch->ends.size());
  EpisodesToProto(batch->episodes, message->mutable_episodes());
  message->clear_snapshots();
  for (std::string& snapshot : batch->snapshots) message->add_snapshots(std::move(snapshot));
}

absl::Status FromProto(v1::PlayReply* message, int lanes, int frame_bytes, int64_t max_length, StepBatch* batch) {
  const int64_t frame_size = frame_bytes;
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckSize("frames", static_cast<int64_t>(message->frames().size()), lanes * frame_size, "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(ReadFloats("rewards", message->rewards(), lanes, &batch->rewards));
  CRAFTFLEET_RETURN_IF_ERROR(ReadEnds(message->ends(), lanes, &batch->ends));
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("last_frames", static_cast<int64_t>(message->last_frames().size()),
                                       CountTruncated(batch->ends) * frame_size, "bytes"));
  // A reply covers one step: the step of each episode is 0.
  const std::vector<int> end_steps(EndSteps(batch->ends).size(), 0);
  CRAFTFLEET_RETURN_IF_ERROR(ReadEpisodes(message->episodes(), end_steps, &batch->episodes));
  for (const v1::EpisodeMessage& episode : message->episodes()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckEpisode(episode, 1, max_length));
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckRewards(message->rewards()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckSnapshots(message->snapshots(), lanes));
  batch->frames.swap(*message->mutable_frames());
  batch->last_frames.swap(*message->mutable_last_frames());
  batch->snapshots.clear();
  for (std::string& snapshot : *message->mutable_snapshots()) batch->snapshots.push_back(std::move(snapshot));
  return absl::OkStatus();
}

void ToProto(std::vector<Moment> moments, v1::PlayReply* message) {
  message->clear_moments();
  for (Moment& moment : moments) {
    v1::Moment* out = message->add_moments();
    *out->mutable_frame() = std::move(moment.frame);
    *out->mutable_picture() = std::move(moment.picture);
    *out->mutable_semantic() = std::move(moment.semantic);
    out->set_player_x(moment.player_x);
    out->set_player_y(moment.player_y);
    out->mutable_inventory()->Assign(moment.inventory.begin(), moment.inventory.end());
    out->mutable_achievements()->Assign(moment.achievements.begin(), moment.achievements.end());
  }
}

absl::StatusOr<std::vector<Moment>> MomentsFromProto(v1::PlayReply* message, int lanes, int frame_bytes,
                                                     int picture_bytes) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("moments", message->moments_size(), lanes, "moments"));
  std::vector<Moment> moments(lanes);
  for (int i = 0; i < lanes; ++i) {
    CRAFTFLEET_RETURN_IF_ERROR(ReadMoment(message->mutable_moments(i), frame_bytes, picture_bytes, &moments[i]));
  }
  return moments;
}

absl::Status ActionsFromProto(const v1::StepLanes& request, std::vector<Action>* actions) {
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckSize("actions", static_cast<int64_t>(request.actions().size()), request.lanes_size(), "bytes"));
  CRAFTFLEET_RETURN_IF_ERROR(CheckActions(request.actions()));
  actions->clear();
  for (const char action : request.actions()) actions->push_back(static_cast<Action>(action));
  return absl::OkStatus();
}

}  // namespace craftfleet::wire
