#include "actor/actor_loop.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_format.h>

#include "actor/play_reply.h"
#include "common/backoff.h"
#include "common/keyed_random.h"
#include "common/log.h"
#include "common/seeds.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

// Before playing on after trouble.
constexpr absl::Duration kFirstPause = absl::Milliseconds(100);
constexpr absl::Duration kLastPause = absl::Seconds(2);

constexpr absl::Duration kReportEvery = absl::Milliseconds(500);  // what is seen of environment servers

std::vector<int> LanesOf(const std::vector<HeldPermit>& permits) {
  std::vector<int> lanes;
  lanes.reserve(permits.size());
  for (const HeldPermit& permit : permits) lanes.push_back(permit.lane);
  return lanes;
}

}  // namespace

ActorLoop::ActorLoop(const Options& options, const LearnerClient* learner, PermitBook* permits, PolicySource* policies,
                     FragmentSender* sender, std::unique_ptr<EnvPool> envs, ServerBook* servers)
    : options_(options),
      learner_(learner),
      permits_(permits),
      policies_(policies),
      sender_(sender),
      envs_(std::move(envs)),
      servers_(servers) {}

absl::Status ActorLoop::Run() {
  Backoff backoff(kFirstPause, kLastPause);
  while (true) {
    ReportServers();
    meter_.Switch(Activity::kPermits);
    std::vector<HeldPermit> permits = permits_->Take(options_.index);
    meter_.Switch(Activity::kWire);
    if (permits.empty()) return absl::OkStatus();
    absl::Status status = RunFragment(&permits);
    if (status.ok()) {
      backoff.Reset();
      continue;
    }
    Abandon(permits);
    if (status.code() == absl::StatusCode::kCancelled) return absl::OkStatus();
    if (!called_.has_value() || !MayPass(*called_, status)) return status;
    LogWarning("%d fragments given back: %s", permits.size(), status.message());
    permits_->WaitForClose(backoff.Next());
  }
}

absl::Status ActorLoop::RunFragment(std::vector<HeldPermit>* permits) {
  const HeldPermit first = permits->front();
  called_ = Called::kWeights;
  for (const HeldPermit& permit : *permits) {
    if (permit.policy_version != first.policy_version || permit.epoch != first.epoch) {
      return absl::AbortedError("permits of two iterations at once");
    }
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::shared_ptr<const Policy> policy,
                              policies_->Get(first.epoch, first.policy_version));
  meter_.Switch(Activity::kEnvironment);
  called_ = Called::kSession;
  CRAFTFLEET_RETURN_IF_ERROR(CloseLanesOfOthers(first.policy_version));
  Forget(envs_->Refresh());
  CRAFTFLEET_RETURN_IF_ERROR(OpenLanes(permits));
  if (permits->empty()) return absl::OkStatus();

  std::map<int, HeldPermit> by_lane;
  for (const HeldPermit& permit : *permits) by_lane[permit.lane] = permit;
  const std::vector<int> lanes = envs_->Arrange(LanesOf(*permits));
  std::transform(lanes.begin(), lanes.end(), permits->begin(), [&](int lane) { return by_lane[lane]; });

  CRAFTFLEET_RETURN_IF_ERROR(PlaySteps(*policy, permits));
  return SendFragments(*policy, *permits);
}

absl::Status ActorLoop::CloseLanesOfOthers(int64_t version) {
  const int64_t last = policy_version_.exchange(version);
  if (last == version) return absl::OkStatus();
  meter_.BeginCycle();
  std::vector<int> lanes;
  for (const auto& [lane, held] : held_) {
    if (held.policy_version != last) lanes.push_back(lane);
  }
  Forget(lanes);
  std::vector<int> lost;
  absl::Status status = envs_->Close(lanes, &lost);
  Forget(lost);
  return status;
}

absl::Status ActorLoop::OpenLanes(std::vector<HeldPermit>* permits) {
  // Again where a server fails meanwhile and takes others with it.
  while (true) {
    std::vector<HeldPermit> missing;
    for (const HeldPermit& permit : *permits) {
      const auto held = held_.find(permit.lane);
      const bool is_here =
          held != held_.end() && held->second.epoch == permit.epoch && held->second.next_fragment == permit.fragment;
      if (!is_here) missing.push_back(permit);
    }
    if (missing.empty()) return absl::OkStatus();
    CRAFTFLEET_RETURN_IF_ERROR(OpenMissing(missing, permits));
  }
}

absl::Status ActorLoop::OpenMissing(const std::vector<HeldPermit>& missing, std::vector<HeldPermit>* permits) {
  called_ = Called::kSnapshot;
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<absl::StatusOr<LaneSnapshot>> snapshots,
                              learner_->GetSnapshots(missing, options_.state_size));
  called_ = Called::kSession;
  std::vector<EnvClient::Lane> lanes;
  std::vector<size_t> rows;  // of `missing`, of each of `lanes`
  for (size_t i = 0; i < missing.size(); ++i) {
    if (!snapshots[i].ok()) {
      Fail(missing[i], CutReason(snapshots[i].status().message()), permits);
      continue;
    }
    const int lane = missing[i].lane;
    lanes.push_back({lane, LaneSeed(options_.config.seed(), lane), 1, std::move(snapshots[i]->game)});
    rows.push_back(i);
  }
  std::string frames;
  std::vector<int> lost;
  std::vector<EnvClient::Refused> refused;
  CRAFTFLEET_RETURN_IF_ERROR(envs_->Open(lanes, &frames, &lost, &refused));
  for (size_t i = 0; i < lanes.size(); ++i) {
    const HeldPermit& permit = missing[rows[i]];
    held_[permit.lane] = {permit.epoch, permit.fragment, /*policy_version=*/-1, std::string(Frame(frames, i)),
                          std::move(snapshots[rows[i]]->state)};
  }
  for (const EnvClient::Refused& lane : refused) {
    const auto permit = std::find_if(missing.begin(), missing.end(),
                                     [&](const HeldPermit& candidate) { return candidate.lane == lane.lane; });
    Fail(*permit, lane.reason, permits);
  }
  Forget(lost);  // of those just opened, too
  return absl::OkStatus();
}

void ActorLoop::Fail(const HeldPermit& permit, const std::string& reason, std::vector<HeldPermit>* permits) {
  LogWarning("lane %d can't be played from its snapshot before fragment %d, which the learner is told: %s", permit.lane,
             permit.fragment, reason);
  Forget({permit.lane});
  permits_->Fail(permit, reason);
  permits->erase(std::remove(permits->begin(), permits->end(), permit), permits->end());
}

void ActorLoop::StartFragments(const std::vector<HeldPermit>& permits) {
  frames_.clear();
  states_.clear();
  builders_.resize(permits.size());
  for (size_t row = 0; row < permits.size(); ++row) {
    const HeldPermit& permit = permits[row];
    const Held& held = held_[permit.lane];
    frames_.append(held.frame);
    states_.insert(states_.end(), held.state.begin(), held.state.end());
    builders_[row].Start(permit.epoch, permit.lane, permit.fragment, permit.policy_version,
                         options_.config.fragment_steps(), options_.frame_bytes);
  }
}

absl::Status ActorLoop::PlaySteps(const Policy& policy, std::vector<HeldPermit>* permits) {
  const int steps = options_.config.fragment_steps();
  const bool keep_every_state = options_.config.ppo().recurrent_batches() == v1::PpoConfig::PUBLISHED;
  StartFragments(*permits);
  std::vector<int> lanes = LanesOf(*permits);
  std::vector<double> noise(lanes.size());
  std::vector<int> lost;
  for (int t = 0; t < steps; ++t) {
    for (size_t row = 0; row < lanes.size(); ++row) {
      noise[row] = ActionNoise(options_.config.seed(), lanes[row], (*permits)[row].fragment * steps + t);
      if (t == 0 || keep_every_state) builders_[row].AddState(State(row));
    }
    meter_.Switch(Activity::kInference);
    called_.reset();
    CRAFTFLEET_ASSIGN_OR_RETURN(ActResult act, policy.Act(frames_, lanes, noise, absl::MakeSpan(states_)));
    meter_.Switch(Activity::kWire);
    called_ = Called::kSession;
    CRAFTFLEET_RETURN_IF_ERROR(envs_->Step(lanes, act.actions, /*snapshot=*/t + 1 == steps, &batch_, &lost));
    meter_.Switch(Activity::kOther, Activity::kEnvironment, envs_->busy());
    if (!lost.empty()) {
      DropRows(lost, permits, &act);
      lanes = LanesOf(*permits);
      noise.resize(lanes.size());
    }
    called_.reset();
    CRAFTFLEET_RETURN_IF_ERROR(AppendStep(policy, *permits, act));
    meter_.Count(static_cast<int64_t>(permits->size()));
    permits_->SetSteps(options_.index, t + 1);
  }
  return absl::OkStatus();
}

void ActorLoop::DropRows(const std::vector<int>& lost, std::vector<HeldPermit>* permits, ActResult* act) {
  Forget(lost);
  size_t kept = 0;
  for (size_t row = 0; row < permits->size(); ++row) {
    const HeldPermit permit = (*permits)[row];
    if (std::find(lost.begin(), lost.end(), permit.lane) != lost.end()) {
      ++abandoned_;
      permits_->Release(permit);
      continue;
    }
    (*permits)[kept] = permit;
    std::swap(builders_[kept], builders_[row]);
    frames_.replace(kept * options_.frame_bytes, options_.frame_bytes, std::string(Frame(frames_, row)));
    std::copy_n(State(row).begin(), options_.state_size, State(kept).begin());
    act->actions[kept] = act->actions[row];
    act->log_probs[kept] = act->log_probs[row];
    act->values[kept] = act->values[row];
    ++kept;
  }
  permits->resize(kept);
  frames_.resize(kept * options_.frame_bytes);
  states_.resize(kept * options_.state_size);
}

absl::Status ActorLoop::AppendStep(const Policy& policy, const std::vector<HeldPermit>& permits, const ActResult& act) {
  size_t ended = 0;
  size_t truncated = 0;
  for (size_t row = 0; row < permits.size(); ++row) {
    const StepEnd end = batch_.ends[row];
    builders_[row].Append(Frame(frames_, row), act.actions[row], act.log_probs[row], act.values[row],
                          batch_.rewards[row], end);
    if (end == StepEnd::kNone) continue;
    builders_[row].AddEpisode(batch_.episodes[ended++]);
    if (end == StepEnd::kTruncated) {
      CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> value, policy.Values(Frame(batch_.last_frames, truncated++),
                                                                                {permits[row].lane}, State(row)));
      builders_[row].AddTruncationValue(value[0]);
    }
    const absl::Span<float> state = State(row);
    std::fill(state.begin(), state.end(), 0.0F);
  }
  frames_.swap(batch_.frames);
  return absl::OkStatus();
}

absl::Status ActorLoop::SendFragments(const Policy& policy, const std::vector<HeldPermit>& permits) {
  const std::vector<int> lanes = LanesOf(permits);
  meter_.Switch(Activity::kInference);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> bootstrap, policy.Values(frames_, lanes, states_));
  meter_.Switch(Activity::kWire);
  for (size_t row = 0; row < permits.size(); ++row) {
    const std::vector<float> state(State(row).begin(), State(row).end());
    held_[lanes[row]] = {permits[row].epoch, permits[row].fragment + 1, permits[row].policy_version,
                         std::string(Frame(frames_, row)), state};
    CRAFTFLEET_RETURN_IF_ERROR(
        sender_->Push(builders_[row].Finish(bootstrap[row], {std::move(batch_.snapshots[row]), state})));
  }
  return absl::OkStatus();
}

void ActorLoop::Abandon(const std::vector<HeldPermit>& permits) {
  // The games stand somewhere inside the fragment: whoever plays it next begins with the snapshot.
  held_.clear();
  envs_->Reset();
  abandoned_ += static_cast<int64_t>(permits.size());
  for (const HeldPermit& permit : permits) permits_->Release(permit);
}

void ActorLoop::Forget(const std::vector<int>& lanes) {
  for (const int lane : lanes) held_.erase(lane);
}

void ActorLoop::ReportServers() {
  const absl::Time now = clock_.Now();
  if (now - reported_ < kReportEvery) return;
  reported_ = now;
  servers_->Update(options_.index, envs_->Report());
}

}  // namespace craftfleet
