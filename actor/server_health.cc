#include "actor/server_health.h"

#include <algorithm>
#include <iterator>
#include <utility>

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
constexpr int64_t kKeptFiles = 128;

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
  BecomeSuspect(&server, why);
  Prepare(endpoint, &server);
}

absl::Status ServerHealth::ErrorOf(const std::string& address) const {
  const MutexLock lock(&mu_);
  const auto found = servers_.find(address);
  return found == servers_.end() ? absl::OkStatus() : found->second.error;
}

void ServerHealth::BecomeSuspect(Server* server, const absl::Status& why) {
  const absl::Time now = SteadyNow();
  const bool first = server->pause == absl::ZeroDuration() ||
                     (server->state == State::kGood && now - server->good_since > kForgiveAfter);
  server->pause = first ? options_.first_pause : std::min(2 * server->pause, options_.last_pause);
  server->next_probe = now + server->pause;
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
  while (!stopping_) {
    changed_state_ = false;
    changed_.WaitFor(&mu_, Look(), [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || changed_state_; });
  }
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
    if (SteadyNow() - server.asked_for > kForgetAfter) {
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
  if (came_back) server->next_probe = std::min(server->next_probe, now);
  return reachable && now >= server->next_probe && now - server->last_probe >= kBetweenProbes;
}

void ServerHealth::Probe(const std::string& address, EnvClient* client) {
  TakeResult(address, [&]() -> absl::Status {
    CRAFTFLEET_RETURN_IF_ERROR(client->Connect(kConnectPatience));
    std::string frames;
    CRAFTFLEET_RETURN_IF_ERROR(client->Open({{0, 0, 1, ""}}, &frames));
    CRAFTFLEET_RETURN_IF_ERROR(client->SendStep({0}, {Action::kNoop}, /*snapshot=*/true));
    StepBatch batch;
    CRAFTFLEET_RETURN_IF_ERROR(client->ReceiveStep(&batch));
    client->Leave();
    return absl::OkStatus();
  }());
}

void ServerHealth::TakeResult(const std::string& address, const absl::Status& result) {
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
  } else {
    // The server answers. If it answers with an error, the playing threads handle that.
    if (server.state == State::kSuspect) LogInfo("environment server %s answers again", address);
    server.state = State::kGood;
    server.error = absl::OkStatus();
    server.good_since = server.last_probe;
  }
}

}  // namespace craftfleet
