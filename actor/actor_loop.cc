#include "actor/actor_loop.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "actor/play_reply.h"
#include "common/base/backoff.h"
#include "common/base/crafter.h"
#include "common/base/keyed_random.h"
#include "common/base/seeds.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"
#include "common/wire/fragment_check.h"

namespace craftfleet {
namespace {

// Pauses before playing again after an error.
constexpr absl::Duration kFirstPause = absl::Milliseconds(100);
constexpr absl::Duration kLastPause = absl::Seconds(2);

constexpr absl::Duration kReportEvery = absl::Milliseconds(500);  // of the state of environment servers

constexpr int kRecordBytes = 128;  // of a usual scene record

}  // namespace

ActorLoop::ActorLoop(const Options& options, const LearnerClient* learner, PermitTracker* permits,
                     PolicySource* policies, LearnerStream* stream, std::unique_ptr<EnvPool> envs,
                     EnvServerTracker* servers)
    : options_(options),
      learner_(learner),
      permits_(permits),
      policies_(policies),
      stream_(stream),
      envs_(std::move(envs)),
      servers_(servers) {}

absl::Status ActorLoop::Run() {
  Backoff backoff(kFirstPause, kLastPause);
  while (true) {
    ReportServers();
    meter_.Switch(Activity::kPermits);
    const std::vector<HeldPermit> permits = permits_->Take(options_.index, kReportEvery);
    if (permits.empty() && !permits_->closed()) {  // while the learner trains or is paused
      Forget(envs_->Refresh());                    // a server that is being drained waits for its last game
      continue;
    }
    meter_.Switch(Activity::kWire);
    if (permits.empty()) return absl::OkStatus();
    absl::Status status = RunFragment(permits);
    if (status.ok()) {
      backoff.Reset();
      continue;
    }
    const size_t released = rows_.size();
    Abandon();
    if (status.code() == absl::StatusCode::kCancelled) return absl::OkStatus();
    if (!call_.has_value() || !IsTransient(*call_, status)) return status;
    log_.Warn(absl::StatusCodeToString(status.code()),
              absl::StrFormat("%d fragments returned: %s", released, status.message()));
    permits_->WaitForClose(backoff.Next());
  }
}

absl::Status ActorLoop::RunFragment(const std::vector<HeldPermit>& permits) {
  rows_.resize(permits.size());
  for (size_t row = 0; row < permits.size(); ++row) rows_[row].permit = permits[row];
  const HeldPermit first = permits.front();
  call_ = CallKind::kWeights;
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::shared_ptr<const Policy> policy,
                              policies_->Get(first.epoch, first.policy_version));
  meter_.Switch(Activity::kEnvironment);
  call_ = CallKind::kSession;
  CRAFTFLEET_RETURN_IF_ERROR(CloseLanesOfOthers(first.policy_version));
  Forget(envs_->Refresh());
  CRAFTFLEET_RETURN_IF_ERROR(OpenLanes());
  if (rows_.empty()) return absl::OkStatus();
  ArrangeRows();
  CRAFTFLEET_RETURN_IF_ERROR(PlaySteps(*policy));
  return SendFragments(*policy);
}

absl::Status ActorLoop::CloseLanesOfOthers(int64_t version) {
  const int64_t last = policy_version_.exchange(version);
  if (last == version) return absl::OkStatus();
  meter_.BeginCycle();
  std::vector<int> lanes;
  for (const auto& [lane, game] : games_) {
    // With max_staleness the lanes of an actor change to the next version one by one.
    const int64_t unplayed = last - game.policy_version;
    if (unplayed < 0 || unplayed > options_.config.max_staleness()) lanes.push_back(lane);
  }
  Forget(lanes);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<int> lost, envs_->Close(lanes));
  Forget(lost);
  return absl::OkStatus();
}

absl::Status ActorLoop::OpenLanes() {
  // The learner reset these lanes: discard their games and load the snapshots.
  for (const Row& row : rows_) {
    if (row.permit.reload) games_.erase(row.permit.lane);
  }
  // Repeat if a server fails in the meantime and its lanes are lost.
  while (true) {
    std::vector<HeldPermit> missing;
    for (const Row& row : rows_) {
      const auto game = games_.find(row.permit.lane);
      const bool is_open = game != games_.end() && game->second.epoch == row.permit.epoch &&
                           game->second.next_fragment == row.permit.fragment;
      if (!is_open) missing.push_back(row.permit);
    }
    if (missing.empty()) return absl::OkStatus();
    CRAFTFLEET_RETURN_IF_ERROR(OpenMissing(missing));
  }
}

absl::Status ActorLoop::OpenMissing(const std::vector<HeldPermit>& missing) {
  call_ = CallKind::kSnapshot;
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<absl::StatusOr<LaneSnapshot>> snapshots,
                              learner_->GetSnapshots(missing, options_.state_size));
  call_ = CallKind::kSession;
  std::vector<EnvClient::Lane> lanes;
  std::vector<size_t> indices;  // into `missing`, of each of `lanes`
  for (size_t i = 0; i < missing.size(); ++i) {
    if (!snapshots[i].ok()) {
      Fail(missing[i], CutReason(snapshots[i].status().message()));
      continue;
    }
    const int lane = missing[i].lane;
    lanes.push_back({lane, LaneSeed(options_.config.seed(), lane), 1, std::move(snapshots[i]->game)});
    indices.push_back(i);
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(EnvPool::Opened opened, envs_->Open(lanes));
  for (size_t i = 0; i < lanes.size(); ++i) {
    const HeldPermit& permit = missing[indices[i]];
    EnvPool::OpenedLane& lane = opened.lanes[i];
    if (lane.refusal.empty()) {
      games_[permit.lane] = {permit.epoch,           permit.fragment,
                             /*policy_version=*/-1,  std::move(lane.frame),
                             std::move(lane.record), std::move(snapshots[indices[i]]->state)};
    } else {
      Fail(permit, lane.refusal);
    }
  }
  Forget(opened.lost);  // may include lanes just opened
  return absl::OkStatus();
}

void ActorLoop::Fail(const HeldPermit& permit, const std::string& reason) {
  LogWarning("lane %d can't be played from its snapshot before fragment %d; reported to the learner: %s", permit.lane,
             permit.fragment, reason);
  Forget({permit.lane});
  permits_->Fail(permit, reason);
  rows_.erase(std::remove_if(rows_.begin(), rows_.end(), [&](const Row& row) { return row.permit == permit; }),
              rows_.end());
}

void ActorLoop::ArrangeRows() {
  std::map<int, HeldPermit> by_lane;
  for (const Row& row : rows_) by_lane[row.permit.lane] = row.permit;
  const std::vector<int> lanes = envs_->Arrange(Lanes());
  for (size_t row = 0; row < lanes.size(); ++row) rows_[row].permit = by_lane[lanes[row]];
}

std::vector<int> ActorLoop::Lanes() const {
  std::vector<int> lanes;
  lanes.reserve(rows_.size());
  for (const Row& row : rows_) lanes.push_back(row.permit.lane);
  return lanes;
}

void ActorLoop::StartFragments() {
  frames_.clear();
  states_.clear();
  for (Row& row : rows_) {
    const HeldPermit& permit = row.permit;
    Game& game = games_[permit.lane];
    frames_.append(game.frame);
    states_.insert(states_.end(), game.state.begin(), game.state.end());
    row.record = std::move(game.record);
    row.fragment = Fragment();
    Fragment& fragment = row.fragment;
    fragment.epoch = permit.epoch;
    fragment.lane = permit.lane;
    fragment.number = permit.fragment;
    fragment.policy_version = permit.policy_version;
    if (options_.format != nullptr && !row.record.empty()) fragment.frame_format = options_.format->load();
    const bool is_scene = fragment.frame_format == FrameFormat::kScene;
    const auto steps = static_cast<size_t>(options_.config.fragment_steps());
    fragment.frames.reserve(steps * (is_scene ? kRecordBytes : options_.frame_bytes));
    fragment.actions.reserve(steps);
    fragment.log_probs.reserve(steps);
    fragment.values.reserve(steps);
    fragment.rewards.reserve(steps);
    fragment.ends.reserve(steps);
  }
}

absl::Status ActorLoop::PlaySteps(const Policy& policy) {
  const int steps = options_.config.fragment_steps();
  StartFragments();
  std::vector<int> lanes = Lanes();
  std::vector<double> noise(lanes.size());
  for (int t = 0; t < steps; ++t) {
    for (size_t row = 0; row < rows_.size(); ++row) {
      noise[row] = ActionNoise(options_.config.seed(), lanes[row], rows_[row].permit.fragment * steps + t);
      if (t > 0 && !options_.keeps_every_state) continue;
      std::vector<float>& states = rows_[row].fragment.states;
      states.insert(states.end(), State(row).begin(), State(row).end());
    }
    meter_.Switch(Activity::kInference);
    call_.reset();
    CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult act, policy.Act(frames_, lanes, noise, absl::MakeSpan(states_)));
    meter_.Switch(Activity::kWire);
    call_ = CallKind::kSession;
    CRAFTFLEET_ASSIGN_OR_RETURN(EnvPool::Stepped stepped, envs_->Step(lanes, act.actions, /*snapshot=*/t + 1 == steps));
    meter_.Switch(Activity::kOther, Activity::kEnvironment, stepped.busy);
    call_.reset();
    CRAFTFLEET_RETURN_IF_ERROR(AppendStep(policy, act, &stepped));
    if (policy.has_memory()) CRAFTFLEET_RETURN_IF_ERROR(UpdateMemories(policy, stepped));
    if (!stepped.lost.empty()) {
      DropRows(stepped.lost);
      lanes = Lanes();
      noise.resize(lanes.size());
    }
    frames_ = std::move(stepped.frames);
    meter_.Count(static_cast<int64_t>(rows_.size()));
  }
  return absl::OkStatus();
}

absl::Status ActorLoop::AppendStep(const Policy& policy, const ActResult& act, EnvPool::Stepped* stepped) {
  auto lane = stepped->lanes.begin();  // in row order, without lost lanes
  for (size_t row = 0; row < rows_.size() && lane != stepped->lanes.end(); ++row) {
    if (lane->lane != rows_[row].permit.lane) continue;
    Fragment& fragment = rows_[row].fragment;
    const bool is_scene = fragment.frame_format == FrameFormat::kScene;
    absl::StrAppend(&fragment.frames, is_scene ? rows_[row].record : Frame(row));
    fragment.actions.push_back(static_cast<char>(act.actions[row]));
    fragment.log_probs.push_back(act.log_probs[row]);
    fragment.values.push_back(act.values[row]);
    fragment.rewards.push_back(lane->reward);
    fragment.ends.push_back(lane->end);
    fragment.snapshot.game = std::move(lane->snapshot);
    rows_[row].record = std::move(lane->record);
    if (lane->end != StepEnd::kNone) {
      const absl::Span<float> state = State(row);
      fragment.episodes.push_back(lane->episode);
      fragment.episodes.back().step = static_cast<int>(fragment.ends.size()) - 1;
      if (lane->end == StepEnd::kTruncated) {
        CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> value,
                                    policy.Values(lane->last_frame, {lane->lane}, state));
        fragment.truncation_values.push_back(value[0]);
      }
      std::fill(state.begin(), state.end(), 0.0F);
    }
    ++lane;
  }
  return absl::OkStatus();
}

absl::Status ActorLoop::UpdateMemories(const Policy& policy, const EnvPool::Stepped& stepped) {
  std::vector<size_t> rows;
  std::vector<int> lanes;
  std::string before;
  std::string after;
  size_t row = 0;
  for (size_t i = 0; i < stepped.lanes.size(); ++i) {  // in row order, without lost lanes
    while (rows_[row].permit.lane != stepped.lanes[i].lane) ++row;
    if (stepped.lanes[i].end != StepEnd::kNone || !UnlocksAchievement(stepped.lanes[i].reward)) continue;
    rows.push_back(row);
    lanes.push_back(stepped.lanes[i].lane);
    absl::StrAppend(&before, Frame(row));
    after.append(stepped.frames, i * options_.frame_bytes, options_.frame_bytes);
  }
  if (rows.empty()) return absl::OkStatus();
  std::vector<float> memories(rows.size() * options_.state_size);
  CRAFTFLEET_RETURN_IF_ERROR(policy.Remember(before, after, lanes, absl::MakeSpan(memories)));
  for (size_t i = 0; i < rows.size(); ++i) {
    std::copy_n(memories.begin() + i * options_.state_size, options_.state_size, State(rows[i]).begin());
  }
  return absl::OkStatus();
}

void ActorLoop::DropRows(const std::vector<int>& lost) {
  Forget(lost);
  size_t kept = 0;
  for (size_t row = 0; row < rows_.size(); ++row) {
    if (std::find(lost.begin(), lost.end(), rows_[row].permit.lane) != lost.end()) {
      ++abandoned_;
      permits_->Release(rows_[row].permit);
      continue;
    }
    if (kept != row) {
      std::swap(rows_[kept], rows_[row]);
      std::copy_n(State(row).begin(), options_.state_size, State(kept).begin());
    }
    ++kept;
  }
  rows_.resize(kept);
  states_.resize(kept * options_.state_size);
}

absl::Status ActorLoop::SendFragments(const Policy& policy) {
  meter_.Switch(Activity::kInference);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> bootstrap, policy.Values(frames_, Lanes(), states_));
  meter_.Switch(Activity::kWire);
  for (size_t row = 0; row < rows_.size(); ++row) {
    const HeldPermit& permit = rows_[row].permit;
    const std::vector<float> state(State(row).begin(), State(row).end());
    Fragment& fragment = rows_[row].fragment;
    fragment.bootstrap_value = bootstrap[row];
    fragment.snapshot.state = state;
    wire::ClampPredictions(&fragment);
    games_[permit.lane] = {
        permit.epoch, permit.fragment + 1, permit.policy_version, std::string(Frame(row)), std::move(rows_[row].record),
        state};
    CRAFTFLEET_RETURN_IF_ERROR(stream_->Push(std::move(fragment)));
  }
  return absl::OkStatus();
}

void ActorLoop::Abandon() {
  // The games are in the middle of a fragment, which will be played again from its snapshot.
  games_.clear();
  envs_->Reset();
  abandoned_ += static_cast<int64_t>(rows_.size());
  for (const Row& row : rows_) permits_->Release(row.permit);
}

void ActorLoop::Forget(const std::vector<int>& lanes) {
  for (const int lane : lanes) games_.erase(lane);
}

void ActorLoop::ReportServers() {
  const absl::Time now = clock_.Now();
  if (now - reported_ < kReportEvery) return;
  reported_ = now;
  servers_->Update(options_.index, envs_->Report());
}

}  // namespace craftfleet
