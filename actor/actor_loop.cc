#include "actor/actor_loop.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_format.h>

#include "actor/trouble.h"
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
    const absl::Status status = RunFragment(permits);
    if (status.ok()) {
      backoff.Reset();
      continue;
    }
    Abandon(permits);
    if (status.code() == absl::StatusCode::kCancelled) return absl::OkStatus();
    if (!MayPass(status)) return status;
    LogWarning("%d fragments given back: %s", permits.size(), status.message());
    permits_->WaitForClose(backoff.Next());
  }
}

absl::Status ActorLoop::RunFragment(const std::vector<HeldPermit>& permits) {
  const HeldPermit& first = permits.front();
  for (const HeldPermit& permit : permits) {
    if (permit.policy_version != first.policy_version || permit.epoch != first.epoch) {
      return absl::AbortedError("permits of two iterations at once");
    }
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::shared_ptr<const Policy> policy,
                              policies_->Get(first.epoch, first.policy_version));
  meter_.Switch(Activity::kEnvironment);
  CRAFTFLEET_RETURN_IF_ERROR(CloseLanesOfOthers(first.policy_version));
  for (const int lane : envs_->Refresh()) held_.erase(lane);
  CRAFTFLEET_RETURN_IF_ERROR(OpenLanes(permits));

  std::map<int, const HeldPermit*> by_lane;
  std::vector<int> lanes;
  for (const HeldPermit& permit : permits) {
    by_lane[permit.lane] = &permit;
    lanes.push_back(permit.lane);
  }
  lanes = envs_->Arrange(std::move(lanes));
  std::vector<HeldPermit> arranged;
  for (const int lane : lanes) arranged.push_back(*by_lane[lane]);

  CRAFTFLEET_RETURN_IF_ERROR(PlaySteps(*policy, arranged));
  return SendFragments(*policy, arranged);
}

absl::Status ActorLoop::CloseLanesOfOthers(int64_t version) {
  const int64_t last = policy_version_.exchange(version);
  if (last == version) return absl::OkStatus();
  meter_.BeginCycle();
  std::vector<int> lanes;
  for (const auto& [lane, held] : held_) {
    if (held.policy_version != last) lanes.push_back(lane);
  }
  for (const int lane : lanes) held_.erase(lane);
  return envs_->Close(lanes);
}

absl::Status ActorLoop::OpenLanes(const std::vector<HeldPermit>& permits) {
  std::vector<EnvClient::Lane> to_open;
  std::vector<std::vector<float>> states;
  for (const HeldPermit& permit : permits) {
    const auto held = held_.find(permit.lane);
    if (held != held_.end() && held->second.epoch == permit.epoch && held->second.next_fragment == permit.fragment) {
      continue;
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(LaneSnapshot snapshot,
                                learner_->GetSnapshot(permit.epoch, permit.lane, permit.fragment, options_.state_size));
    to_open.push_back({permit.lane, LaneSeed(options_.config.seed(), permit.lane), 1, std::move(snapshot.game)});
    states.push_back(std::move(snapshot.state));
  }
  if (to_open.empty()) return absl::OkStatus();
  std::string frames;
  CRAFTFLEET_RETURN_IF_ERROR(envs_->Open(to_open, &frames));
  for (size_t i = 0; i < to_open.size(); ++i) {
    Held& held = held_[to_open[i].lane];
    held.frame = std::string(Frame(frames, i));
    held.state = std::move(states[i]);
  }
  return absl::OkStatus();
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

absl::Status ActorLoop::PlaySteps(const Policy& policy, const std::vector<HeldPermit>& permits) {
  const int steps = options_.config.fragment_steps();
  const bool keep_every_state = options_.config.ppo().recurrent_batches() == v1::PpoConfig::PUBLISHED;
  std::vector<int> lanes;
  for (const HeldPermit& permit : permits) lanes.push_back(permit.lane);
  StartFragments(permits);
  std::vector<double> noise(lanes.size());
  for (int t = 0; t < steps; ++t) {
    for (size_t row = 0; row < lanes.size(); ++row) {
      noise[row] = ActionNoise(options_.config.seed(), lanes[row], permits[row].fragment * steps + t);
      if (t == 0 || keep_every_state) builders_[row].AddState(State(row));
    }
    meter_.Switch(Activity::kInference);
    CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult act, policy.Act(frames_, lanes, noise, absl::MakeSpan(states_)));
    meter_.Switch(Activity::kWire);
    CRAFTFLEET_RETURN_IF_ERROR(envs_->Step(lanes, act.actions, /*snapshot=*/t + 1 == steps, &batch_));
    meter_.Switch(Activity::kOther, Activity::kEnvironment, envs_->busy());
    CRAFTFLEET_RETURN_IF_ERROR(AppendStep(policy, lanes, act));
    meter_.Count(static_cast<int64_t>(lanes.size()));
  }
  return absl::OkStatus();
}

absl::Status ActorLoop::AppendStep(const Policy& policy, const std::vector<int>& lanes, const ActResult& act) {
  size_t ended = 0;
  size_t truncated = 0;
  for (size_t row = 0; row < lanes.size(); ++row) {
    const StepEnd end = batch_.ends[row];
    builders_[row].Append(Frame(frames_, row), act.actions[row], act.log_probs[row], act.values[row],
                          batch_.rewards[row], end);
    if (end == StepEnd::kNone) continue;
    builders_[row].AddEpisode(batch_.episodes[ended++]);
    if (end == StepEnd::kTruncated) {
      CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> value,
                                  policy.Values(Frame(batch_.last_frames, truncated++), {lanes[row]}, State(row)));
      builders_[row].AddTruncationValue(value[0]);
    }
    const absl::Span<float> state = State(row);
    std::fill(state.begin(), state.end(), 0.0F);
  }
  frames_.swap(batch_.frames);
  return absl::OkStatus();
}

absl::Status ActorLoop::SendFragments(const Policy& policy, const std::vector<HeldPermit>& permits) {
  std::vector<int> lanes;
  for (const HeldPermit& permit : permits) lanes.push_back(permit.lane);
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

void ActorLoop::ReportServers() {
  const absl::Time now = clock_.Now();
  if (now - reported_ < kReportEvery) return;
  reported_ = now;
  servers_->Update(options_.index, envs_->Report());
}

}  // namespace craftfleet
