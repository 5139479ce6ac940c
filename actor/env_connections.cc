#include "actor/env_connections.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/time/clock.h>

#include "actor/error_policy.h"
#include "common/telemetry/process_usage.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kConnectTimeout = absl::Seconds(3);
constexpr absl::Duration kMoment = absl::Milliseconds(200);   // wait for other servers once one is connected
constexpr absl::Duration kLookEvery = absl::Milliseconds(5);  // while no server is connected
constexpr int64_t kFilesOfServer = 2;

}  // namespace

EnvConnections::EnvConnections(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes,
                               std::shared_ptr<ServerHealth> health)
    : directory_(std::move(directory)), hello_(hello), frame_bytes_(frame_bytes), health_(std::move(health)) {}

bool EnvConnections::Follow() {
  if (generation_ == directory_->generation()) return false;
  generation_ = directory_->generation();
  std::vector<std::unique_ptr<Server>> before;
  const MutexLock lock(&mu_);
  before.swap(servers_);
  for (const wire::Endpoint& endpoint : directory_->Servers()) {
    const auto known = std::find_if(before.begin(), before.end(), [&](const auto& server) {
      return server != nullptr && server->client->address() == endpoint.address;
    });
    if (known != before.end()) {
      servers_.push_back(std::move(*known));
      continue;
    }
    servers_.push_back(std::make_unique<Server>());
    servers_.back()->client = std::make_unique<EnvClient>(endpoint, hello_, frame_bytes_, health_->timeout());
    if (cancelled_) servers_.back()->client->Cancel();
  }
  return true;
}

std::vector<std::string> EnvConnections::Addresses() const {
  std::vector<std::string> addresses;
  for (const auto& server : servers_) addresses.push_back(server->client->address());
  return addresses;
}

absl::Status EnvConnections::Drop(size_t index, const absl::Status& why, int lanes) {
  Server& server = *servers_[index];
  const bool stopping = cancelled();
  if (!stopping) {
    Warn(server, why, absl::StrFormat("%s; its %d games continue from their snapshots", why.message(), lanes));
    if (ReactionTo(CallKind::kSession, why) == Reaction::kProbeFirst) health_->Suspect(server.client->server(), why);
  }
  server.client->Disconnect();
  server.error = why;
  return stopping ? absl::CancelledError("stopping") : absl::OkStatus();
}

void EnvConnections::Postpone(size_t server) {
  servers_[server]->next_try = SteadyNow() + servers_[server]->backoff.Next();
}

bool EnvConnections::MustLeave(const ServerHealth::View& health) const {
  if (!health.is_slow) return !health.error.ok();
  return health.should_leave && std::any_of(servers_.begin(), servers_.end(), [this](const auto& other) {
           return other->client->connected() && health_->Of(other->client->address()).error.ok();
         });
}

void EnvConnections::DisconnectAll() {
  for (const auto& server : servers_) server->client->Disconnect();
}

void EnvConnections::Cancel() {
  const MutexLock lock(&mu_);
  cancelled_ = true;
  for (const auto& server : servers_) server->client->Cancel();
}

bool EnvConnections::cancelled() const {
  const MutexLock lock(&mu_);
  return cancelled_;
}

void EnvConnections::ConnectReachable() {
  std::vector<Server*> due;
  for (const auto& server : servers_) {
    if (!server->client->connected() && SteadyNow() >= server->next_try) due.push_back(server.get());
  }
  int64_t files_left = due.empty() ? 0 : FilesLeft();
  for (Server* server : due) {
    const std::string name = absl::StrCat("environment server ", server->client->address());
    files_left -= kFilesOfServer;
    if (files_left < kKeptFiles) {
      TryLater(server, absl::ResourceExhaustedError(
                           absl::StrCat(name,
                                        ": not used, too many open files; raise the limit (ulimit -n) or "
                                        "list fewer servers")));
    } else if (server->client->Reachable()) {
      if (health_->MayUse(server->client->server())) {
        Connect(server);
        continue;
      }
      // The reason was logged when the server became suspect.
      server->error = health_->Of(server->client->address()).error;
      if (server->error.ok()) server->error = absl::UnavailableError(name + ": has not answered a probe yet");
    } else if (server->client->Failing() && server->error.ok()) {
      SetError(server, absl::UnavailableError(name + ": not reachable; it gets games as soon as it is"));
    }
  }
}

absl::Status EnvConnections::ConnectAny() {
  ConnectReachable();
  if (!AnyConnected()) WaitForServers();
  if (!AnyConnected()) ConnectSlow();
  return AnyConnected() ? absl::OkStatus() : WhyNone();
}

void EnvConnections::ConnectSlow() {
  for (const auto& server : servers_) {
    if (health_->Of(server->client->address()).is_slow && server->client->Reachable()) Connect(server.get());
  }
}

void EnvConnections::WaitForServers() {
  // Once one server is connected, wait only a moment longer for the others: the first games are then spread over all
  // servers, and a server that does not answer does not delay the start.
  absl::Time patience_ends = SteadyNow() + kConnectTimeout;
  bool any = false;
  while (!cancelled()) {
    bool more = false;  // there are servers to wait for
    for (const auto& server : servers_) {
      if (server->client->connected() || SteadyNow() < server->next_try) continue;
      if (server->client->Failing()) {
        Connect(server.get());  // logs errors
      } else {
        more |= health_->Of(server->client->address()).error.ok();
      }
    }
    ConnectReachable();
    if (AnyConnected() && !std::exchange(any, true)) {
      patience_ends = std::min(patience_ends, SteadyNow() + kMoment);
    }
    if (!more || SteadyNow() >= patience_ends) break;
    absl::SleepFor(kLookEvery);
  }
  for (const auto& server : servers_) {
    if (any || server->client->connected() || !server->error.ok()) continue;
    TryLater(server.get(),
             absl::UnavailableError(absl::StrCat("environment server ", server->client->address(),
                                                 ": no answer within ", absl::FormatDuration(kConnectTimeout))));
  }
}

absl::Status EnvConnections::WhyNone() const {
  if (cancelled()) return absl::CancelledError("stopping");
  if (servers_.empty()) return absl::UnavailableError("no environment server is known yet");
  const bool none_fits = std::all_of(servers_.begin(), servers_.end(), [](const auto& server) {
    return !server->error.ok() && ReactionTo(CallKind::kSession, server->error) == Reaction::kUnfit;
  });
  // If any server has accepted this actor before, the refusals are likely temporary: its rights are being changed, or
  // another run occupies the server.
  if (none_fits && directory_->fixed() && !ever_connected_) return servers_.front()->error;
  return absl::UnavailableError(absl::StrJoin(
      servers_, "; ", [](std::string* out, const auto& server) { absl::StrAppend(out, server->error.message()); }));
}

void EnvConnections::Connect(Server* server) {
  const absl::Status status = server->client->Connect(absl::ZeroDuration());
  if (!status.ok()) {
    TryLater(server, status);
    if (!cancelled() && ReactionTo(CallKind::kSession, status) == Reaction::kProbeFirst) {
      health_->Suspect(server->client->server(), status);
    }
    return;
  }
  ever_connected_ = true;
  server->backoff.Reset();
  server->error = absl::OkStatus();
}

void EnvConnections::TryLater(Server* server, const absl::Status& error) {
  server->next_try = SteadyNow() + server->backoff.Next();
  SetError(server, error);
}

void EnvConnections::SetError(Server* server, const absl::Status& error) {
  const bool is_new = server->error != error && !absl::IsCancelled(error);
  server->error = error;
  if (is_new) Warn(*server, error, error.message());
}

void EnvConnections::Warn(const Server& server, const absl::Status& error, absl::string_view text) {
  log_.Warn(absl::StrCat(server.client->address(), " ", absl::StatusCodeToString(error.code())), text);
}

bool EnvConnections::AnyConnected() const {
  return std::any_of(servers_.begin(), servers_.end(), [](const auto& server) { return server->client->connected(); });
}

}  // namespace craftfleet
