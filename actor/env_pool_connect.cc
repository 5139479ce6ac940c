// How an EnvPool comes by its servers; env_pool.cc plays on them.

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/time/clock.h>

#include "actor/env_pool.h"
#include "actor/error_policy.h"
#include "common/clock.h"
#include "common/log.h"
#include "common/process_usage.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kConnectTimeout = absl::Seconds(3);
constexpr absl::Duration kMoment = absl::Milliseconds(200);
constexpr absl::Duration kLookEvery = absl::Milliseconds(5);  // while nothing can be played
constexpr int64_t kKeptFiles = 128;  // descriptors for everything else; gRPC bears badly to be without
constexpr int64_t kFilesOfServer = 2;

}  // namespace

bool EnvPool::cancelled() const {
  const MutexLock lock(&mu_);
  return cancelled_;
}

void EnvPool::ConnectReachable() {
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
                                        ": left out, too many files are open; raise the limit (ulimit -n), or "
                                        "name fewer servers")));
    } else if (server->client->Reachable()) {
      if (health_->MayUse(server->client->server())) {
        Connect(server);
        continue;
      }
      // Who put it under suspicion has said so.
      server->trouble = health_->TroubleOf(server->client->address());
      if (server->trouble.ok()) server->trouble = absl::UnavailableError(name + ": has not answered a probe yet");
    } else if (server->client->Failing() && server->trouble.ok()) {
      Note(server, absl::UnavailableError(name + ": not reachable; it gets games as soon as it is"));
    }
  }
}

absl::Status EnvPool::ConnectServers() {
  ConnectReachable();
  if (!AnyConnected()) WaitForServers();
  return AnyConnected() ? absl::OkStatus() : WhyNone();
}

void EnvPool::WaitForServers() {
  // Nobody waits for a server that does not answer while there is another, but for a moment, so that the first games
  // are spread over all of them.
  absl::Time patience_ends = SteadyNow() + kConnectTimeout;
  bool any = false;
  while (!cancelled()) {
    bool more = false;  // to wait for
    for (const auto& server : servers_) {
      if (server->client->connected() || SteadyNow() < server->next_try) continue;
      if (server->client->Failing()) {
        Connect(server.get());  // says what is wrong
      } else {
        more |= health_->TroubleOf(server->client->address()).ok();
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
    if (any || server->client->connected() || !server->trouble.ok()) continue;
    TryLater(server.get(),
             absl::UnavailableError(absl::StrCat("environment server ", server->client->address(),
                                                 ": no answer within ", absl::FormatDuration(kConnectTimeout))));
  }
}

absl::Status EnvPool::WhyNone() const {
  if (cancelled()) return absl::CancelledError("stopping");
  if (servers_.empty()) return absl::UnavailableError("no environment server is known yet");
  // One that took us once takes us again, when its token or ours is the right one.
  const bool none_fits = std::all_of(servers_.begin(), servers_.end(), [](const auto& server) {
    return !server->trouble.ok() && ReactionTo(Called::kSession, server->trouble) == Reaction::kUnfit;
  });
  const absl::Status& first = servers_.front()->trouble;
  const bool was_welcome = ever_connected_ && (absl::IsPermissionDenied(first) || absl::IsUnauthenticated(first));
  if (none_fits && directory_->fixed() && !was_welcome) return first;
  return absl::UnavailableError(absl::StrJoin(
      servers_, "; ", [](std::string* out, const auto& server) { absl::StrAppend(out, server->trouble.message()); }));
}

void EnvPool::Connect(Server* server) {
  const absl::Status status = server->client->Connect(absl::ZeroDuration());
  if (!status.ok()) {
    TryLater(server, status);
    if (!cancelled() && ReactionTo(Called::kSession, status) == Reaction::kLeaveAlone) {
      health_->Suspect(server->client->server(), status);
    }
    return;
  }
  ever_connected_ = true;
  server->backoff.Reset();
  server->trouble = absl::OkStatus();
}

void EnvPool::TryLater(Server* server, const absl::Status& trouble) {
  server->next_try = SteadyNow() + server->backoff.Next();
  Note(server, trouble);
}

void EnvPool::Note(Server* server, const absl::Status& trouble) {
  const bool news = server->trouble != trouble && !absl::IsCancelled(trouble);
  server->trouble = trouble;
  if (news) LogWarning("%s", trouble.message());
}

bool EnvPool::AnyConnected() const {
  return std::any_of(servers_.begin(), servers_.end(), [](const auto& server) { return server->client->connected(); });
}

}  // namespace craftfleet
