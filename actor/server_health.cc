#include "actor/server_health.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "actor/error_policy.h"
#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"
#include "common/telemetry/process_usage.h"

namespace craftfleet {
namespace {

// Time between two checks whether a wanted or suspect server can be reached.
constexpr absl::Duration kLookSoon = absl::Milliseconds(10);
constexpr absl::Duration kLookEvery = absl::Milliseconds(250);
constexpr absl::Duration kWantedNow = absl::Seconds(3);
constexpr absl::Duration kConnectPatience = absl::Milliseconds(500);  // probes only begin when there is a connection
constexpr absl::Duration kBetweenProbes = absl::Milliseconds(500);    // of one server, however often it reconnects
constexpr absl::Duration kForgetAfter = absl::Minutes(10);
constexpr absl::Duration kBetweenSteps = absl::Milliseconds(20);  // of a probe
constexpr absl::Duration kBeat = absl::Milliseconds(50);          // between two runs of thread_,
constexpr absl::Duration kLate = absl::Milliseconds(250);         // or more: the process was stopped
// A slow server that plays games for want of another is measured by these.
constexpr absl::Duration kInUse = absl::Seconds(10);

std::string Rounded(absl::Duration time) { return absl::FormatDuration(absl::Trunc(time, absl::Microseconds(100))); }

}  // namespace

ServerHealth::ServerHealth(Options options) : options_(std::move(options)), thread_([this] { Run(); }) {}

ServerHealth::~ServerHealth() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    for (auto& [address, server] : servers_) {
      if (server.client != nullptr) server.client->Cancel();
    }
    changed_.NotifyAll();
  }
  thread_.join();
  std::vector<std::thread> probers;
  {
    const MutexLock lock(&mu_);
    for (auto& [address, server] : servers_) {
      if (server.prober.joinable()) probers.push_back(std::move(server.prober));
    }
  }
  for (std::thread& prober : probers) prober.join();
}

bool ServerHealth::MayUse(const wire::Endpoint& endpoint) {
  const MutexLock lock(&mu_);
  const auto [entry, is_new] = servers_.try_emplace(endpoint.address);
  Server& server = entry->second;
  server.asked_for = SteadyNow();
  if (is_new && endpoint.address == wire::kInProcess) server.state = State::kGood;
  if (server.state == State::kGood) return true;
  Prepare(endpoint, &server);
  return false;
}

void ServerHealth::Suspect(const wire::Endpoint& endpoint, const absl::Status& why) {
  const MutexLock lock(&mu_);
  Server& server = servers_[endpoint.address];
  server.asked_for = SteadyNow();
  // Other threads that play there report the same error.
  if (server.state == State::kSuspect) return;
  step_times_.Reset(endpoint.address);
  BecomeSuspect(&server, why);
  Prepare(endpoint, &server);
}

void ServerHealth::NoteStep(const wire::Endpoint& endpoint, absl::Duration time) {
  const MutexLock lock(&mu_);
  const absl::Time now = SteadyNow();
  Server& server = servers_[endpoint.address];
  server.last_step = now;
  if (server.state == State::kNew) BecomeGood(endpoint.address, &server);  // it plays games, and was forgotten
  const bool is_new = step_times_.Add(endpoint.address, RunningSince(now - time), now);
  if (!is_new || (server.state != State::kGood && server.state != State::kSlow)) return;
  const absl::Duration typical = *step_times_.TypicalOf(endpoint.address);
  if (step_times_.IsSlow(endpoint.address, typical)) {
    server.asked_for = now;
    BecomeSlow(endpoint.address, typical, &server);
    Prepare(endpoint, &server);
  } else if (server.state == State::kSlow) {
    BecomeGood(endpoint.address, &server);
  }
}

ServerHealth::View ServerHealth::Of(const std::string& address) const {
  const MutexLock lock(&mu_);
  const auto found = servers_.find(address);
  if (found == servers_.end()) return {};
  const Server& server = found->second;
  const bool is_slow = server.state == State::kSlow;
  return {server.error, is_slow, is_slow && server.should_leave,
          is_slow ? server.step_time : step_times_.TypicalOf(address)};
}

void ServerHealth::BecomeSlow(const std::string& address, absl::Duration step_time, Server* server) {
  const std::optional<absl::Duration> others = step_times_.OthersOf(address);
  server->should_leave = !others.has_value() || step_times_.IsSlowerThanOthers(address, step_time);
  step_times_.Reset(address);
  const std::string compared =
      others.has_value() ? absl::StrCat(", ", Rounded(*others), " on this actor's other servers") : "";
  if (server->state == State::kGood) {
    Postpone(std::max(options_.first_pause, kFirstPauseOfSlow), server);
    LogWarning("environment server %s is slow: a step takes %s%s; %s", address, Rounded(step_time), compared,
               server->should_leave ? "its games move to other servers, if there are any" : "the others are slow too");
  }
  server->state = State::kSlow;
  server->step_time = step_time;
  server->error = absl::UnavailableError(
      absl::StrCat("environment server ", address, ": slow, a step takes ", Rounded(step_time), compared));
}

void ServerHealth::BecomeGood(const std::string& address, Server* server) {
  if (server->state == State::kSuspect) LogInfo("environment server %s answers again", address);
  if (server->state == State::kSlow) LogInfo("environment server %s is no longer slow", address);
  server->state = State::kGood;
  server->error = absl::OkStatus();
  server->good_since = SteadyNow();
}

void ServerHealth::Postpone(absl::Duration first, Server* server) {
  const absl::Time now = SteadyNow();
  const bool is_first = server->pause == absl::ZeroDuration() ||
                        (server->state == State::kGood && now - server->good_since > kForgiveAfter);
  server->pause = is_first ? first : std::min(2 * server->pause, options_.last_pause);
  server->next_probe = now + server->pause;
}

void ServerHealth::BecomeSuspect(Server* server, const absl::Status& why) {
  Postpone(options_.first_pause, server);
  if (server->state != State::kSuspect) {
    LogWarning("%s; not used until it answers a probe, the first one in %s", why.message(),
               absl::FormatDuration(server->pause));
  }
  server->state = State::kSuspect;
  server->error = why;
  server->was_reachable = true;
}

void ServerHealth::Prepare(const wire::Endpoint& endpoint, Server* server) {
  if (server->client != nullptr || server->probing || stopping_ || FilesLeft() < kKeptFiles) return;
  server->client = std::make_unique<EnvClient>(endpoint, options_.hello, options_.frame_bytes, options_.timeout);
  if (server->state == State::kNew) server->next_probe = SteadyNow();
  changed_state_ = true;
  changed_.NotifyAll();
}

void ServerHealth::Run() {
  const MutexLock lock(&mu_);
  absl::Time next_look = absl::InfinitePast();
  while (!stopping_) {
    if (changed_state_ || SteadyNow() >= next_look) {
      changed_state_ = false;
      next_look = SteadyNow() + Look();
    }
    changed_.WaitFor(&mu_, std::min(next_look - SteadyNow(), kBeat),
                     [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || changed_state_; });
    const absl::Time now = SteadyNow();
    if (now - beat_ > kLate) {
      pause_begin_ = beat_;
      pause_end_ = now;
    }
    beat_ = now;
  }
}

absl::Duration ServerHealth::RunningSince(absl::Time begun) const {
  const absl::Time now = SteadyNow();
  const bool is_late = now - beat_ > kLate;  // thread_ has yet to note it
  const absl::Time begin = std::max(begun, is_late ? beat_ : pause_begin_);
  return now - begun - std::max((is_late ? now : pause_end_) - begin, absl::ZeroDuration());
}

absl::Duration ServerHealth::Look() {
  absl::Duration pause = absl::InfiniteDuration();
  for (auto it = servers_.begin(); it != servers_.end();) {
    Server& server = it->second;
    if (server.probing) {
      ++it;  // TakeResult will follow
      continue;
    }
    if (server.prober.joinable()) server.prober.join();  // it has delivered its result
    if (server.state == State::kGood) server.client = nullptr;
    if (SteadyNow() - std::max(server.asked_for, server.last_step) > kForgetAfter) {
      step_times_.Forget(it->first);
      it = servers_.erase(it);
      continue;
    }
    if (server.client != nullptr) {
      const bool is_wanted = server.state == State::kNew && SteadyNow() - server.asked_for < kWantedNow;
      pause = std::min(pause, is_wanted ? kLookSoon : kLookEvery);
      if (IsDue(&server) && probes_ < kMaxProbes) {
        server.probing = true;
        ++probes_;
        server.prober =
            std::thread([this, address = it->first, client = server.client.get()] { Probe(address, client); });
      }
    }
    ++it;
  }
  return pause;
}

bool ServerHealth::IsDue(Server* server) {
  const absl::Time now = SteadyNow();
  const bool reachable = server->client->Reachable();
  const bool came_back = reachable && !server->was_reachable;
  server->was_reachable = reachable;
  if (server->state == State::kSlow && now - server->last_step < kInUse) return false;
  if (came_back && server->state != State::kSlow) server->next_probe = std::min(server->next_probe, now);
  return reachable && now >= server->next_probe && now - server->last_probe >= kBetweenProbes;
}

void ServerHealth::Probe(const std::string& address, EnvClient* client) {
  // Where it was late, one quick answer does not show that it is well.
  const View before = Of(address);
  const bool was_late = before.is_slow || absl::IsDeadlineExceeded(before.error);
  TakeResult(address, PlayProbe(client, was_late ? StepTimes::kWindow : absl::ZeroDuration()));
}

absl::StatusOr<absl::Duration> ServerHealth::PlayProbe(EnvClient* client, absl::Duration duration) {
  CRAFTFLEET_RETURN_IF_ERROR(client->Connect(kConnectPatience));
  std::string frames;
  CRAFTFLEET_RETURN_IF_ERROR(client->Open({{0, 0, 1, ""}}, &frames));
  absl::Duration total;
  int64_t steps = 0;
  StepBatch batch;
  const absl::Time end = SteadyNow() + duration;
  do {
    if (steps > 0) absl::SleepFor(kBetweenSteps);
    const absl::Time begun = SteadyNow();
    CRAFTFLEET_RETURN_IF_ERROR(client->SendStep({0}, {Action::kNoop}, /*snapshot=*/true));
    CRAFTFLEET_RETURN_IF_ERROR(client->ReceiveStep(&batch));
    const MutexLock lock(&mu_);
    total += RunningSince(begun);
    ++steps;
  } while (SteadyNow() < end && !IsStopping());
  client->Leave();
  return total / steps;
}

bool ServerHealth::IsStopping() const {
  const MutexLock lock(&mu_);
  return stopping_;
}

void ServerHealth::TakeResult(const std::string& address, const absl::StatusOr<absl::Duration>& step_time) {
  const absl::Status& result = step_time.status();
  const MutexLock lock(&mu_);
  Server& server = servers_.at(address);
  server.probing = false;
  --probes_;
  changed_state_ = true;
  changed_.NotifyAll();
  server.last_probe = SteadyNow();
  if (stopping_) return;
  if (!result.ok() && ReactionTo(CallKind::kSession, result) == Reaction::kProbeFirst) {
    BecomeSuspect(&server, result);
  } else if (absl::IsUnavailable(result)) {
    // The server is gone. If suspect, it remains so and is probed as soon as there is a connection.
    server.was_reachable = false;
    server.next_probe = server.last_probe + std::max(server.pause, kBetweenProbes);
  } else if (step_time.ok() && server.state != State::kNew && step_times_.IsSlow(address, *step_time)) {
    BecomeSlow(address, *step_time, &server);
    Postpone(kFirstPauseOfSlow, &server);
  } else {
    // The server answers. If it answers with an error, the playing threads handle that.
    BecomeGood(address, &server);
  }
}

}  // namespace craftfleet
