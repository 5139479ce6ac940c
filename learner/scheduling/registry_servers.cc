// WorkerRegistry: environment servers.
#include <algorithm>
#include <utility>

#include "common/base/status_macros.h"
#include "common/telemetry/log.h"
#include "learner/scheduling/worker_registry.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kCheckEvery = absl::Seconds(1);
// How long an actor must be unable to use any server of its list until it gets others; and within which time it
// reports each of them again.
constexpr absl::Duration kUnusableFor = absl::Seconds(3);
constexpr absl::Duration kReportedAgain = absl::Seconds(20);

}  // namespace

absl::Status WorkerRegistry::Announce(const WorkerClient& client, absl::string_view name, absl::string_view address,
                                      int lanes, const WorkerBuild& build,
                                      std::shared_ptr<const v1::ProcessSummary> summary) {
  const MutexLock lock(&mu_);
  ExpireServersSometimes();  // here too, since there may be no actor that requests servers
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const server, Own(WorkerRole::kEnvServer, name, client));
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress(name, address, client));
  if (server->own_report == absl::InfinitePast()) server->address = std::string(address);
  CRAFTFLEET_RETURN_IF_ERROR(CheckBuild(build, server));
  PlaceServer(server, address);
  server->empty = server->draining && lanes == 0;
  server->leased_from = clock_->Now();
  server->lease = ServerLease();
  NoteReport(server, std::move(summary));
  return absl::OkStatus();
}

void WorkerRegistry::PlaceServer(Worker* server, absl::string_view address) {
  if (server->address != address) {
    const auto former = servers_.find(server->address);
    if (former != servers_.end() && former->second == server) {
      RemoveServer(server);
      servers_.erase(former);
    }
  }
  const auto placed = servers_.find(address);
  if (placed != servers_.end() && placed->second != server) {
    placed->second->active = false;  // replaced: lists keep the address
    Erase(placed->second);
  }
  // The record made from actors' reports on this address.
  Worker* const reported = Find(WorkerRole::kEnvServer, address);
  if (reported != nullptr && reported != server && reported->own_report == absl::InfinitePast() &&
      reported->name_used == absl::InfinitePast()) {
    Erase(reported);
  }
  server->address = std::string(address);
  server->active = true;
  servers_[server->address] = server;
  ListServer(*server);
}

void WorkerRegistry::RemoveServer(Worker* server) {
  if (!server->active) return;
  server->active = false;
  ListServer(*server);
}

void WorkerRegistry::ListServer(const Worker& server) {
  if (server.active && !server.draining) {
    lists_.PutServer(server.address, server.client.host);
  } else {
    lists_.RemoveServer(server.address);
  }
}

void WorkerRegistry::NoteServer(const ServerReport& report) {
  const absl::Time now = clock_->Now();
  if (const auto placed = servers_.find(report.address); placed != servers_.end()) {
    if (report.hangs) placed->second->not_answering = now;
    if (report.slow) NoteSlow(report.step_ms, placed->second);
    return;
  }
  Worker* server = Find(WorkerRole::kEnvServer, report.address);
  if (server == nullptr) {
    if (reported_ >= kMaxReported) Prune();
    if (reported_ >= kMaxReported) return;
    server = Record(WorkerRole::kEnvServer, report.address);
    server->reported = true;
    ++reported_;
  }
  if (server->last_seen == absl::InfinitePast()) {
    server->address = report.address;
    server->last_seen = now - kRelayed;
  }
  if (report.answers) server->last_seen = now;
  if (report.hangs) server->not_answering = now;
  if (report.slow) NoteSlow(report.step_ms, server);
  if (report.summary == nullptr) return;
  server->summary = report.summary;
  server->summary_time = now;
}

void WorkerRegistry::NoteSlow(double step_ms, Worker* server) {
  const absl::Time now = clock_->Now();
  if (now - server->slow >= kRelayed) {
    LogWarning("environment server %s is slow: a step takes %.0f ms", server->address, step_ms);
  }
  server->slow = now;
  server->step_ms = step_ms;
}

void WorkerRegistry::NoteUnusable(const std::string& address, Worker* actor) {
  if (servers_.find(address) == servers_.end()) return;
  const absl::Time now = clock_->Now();
  const auto known = actor->unusable.find(address);
  if (known != actor->unusable.end()) {
    Worker::Unusable& unusable = known->second;
    if (now - unusable.reported > kReportedAgain) unusable.since = now;
    unusable.reported = now;
    return;
  }
  if (actor->unusable.size() >= ServerLists::kMost) actor->unusable.clear();  // some are of a former list
  actor->unusable[address] = {now, now};
}

bool WorkerRegistry::LacksServers(const Worker& actor, const std::set<std::string>& addresses) const {
  const absl::Time now = clock_->Now();
  return !addresses.empty() && std::all_of(addresses.begin(), addresses.end(), [&](const std::string& address) {
    const auto unusable = actor.unusable.find(address);
    return unusable != actor.unusable.end() && now - unusable->second.reported <= kReportedAgain &&
           unusable->second.reported - unusable->second.since >= kUnusableFor;
  });
}

void WorkerRegistry::AddServerList(const PermitRequest& request, Worker* actor, PermitReply* reply) {
  if (!request.wants_servers) return;
  const int64_t generation = request.servers_generation;
  reply->servers_generation = generation;
  ExpireServersSometimes();
  // The actor keeps a list from an earlier start of the learner until every server has had time to register again.
  const bool keeps =
      generation != 0 && generation < first_generation_ && clock_->Now() - start_ < options_.server_lease;
  if (keeps) return;
  const ServerLists::List* list = &lists_.ListOf(actor->name, actor->client.host);
  if (LacksServers(*actor, list->addresses)) {
    lists_.Avoid(actor->name);
    actor->unusable.clear();
    list = &lists_.ListOf(actor->name, actor->client.host);
  }
  if (list->generation == generation) return;
  reply->servers_generation = list->generation;
  reply->servers.assign(list->addresses.begin(), list->addresses.end());
}

std::vector<WorkerRegistry::Server> WorkerRegistry::Servers() {
  const MutexLock lock(&mu_);
  ExpireServers();
  std::vector<Server> servers;
  for (const auto& [address, server] : servers_) {
    if (server->active)
      servers.push_back({server->name, address, clock_->Now() - server->leased_from, server->draining});
  }
  return servers;
}

absl::Duration WorkerRegistry::LeaseForServers() const {
  const MutexLock lock(&mu_);
  return ServerLease();
}

absl::Duration WorkerRegistry::ServerLease() const {
  return options_.server_lease * std::clamp(static_cast<int>(lists_.servers() / kServersOfALease), 1, kMaxLeases);
}

void WorkerRegistry::ExpireServersSometimes() {
  if (clock_->Now() - servers_checked_ >= kCheckEvery) ExpireServers();
}

void WorkerRegistry::ExpireServers() {
  servers_checked_ = clock_->Now();
  for (const auto& [address, server] : servers_) {
    if (server->active && servers_checked_ - server->leased_from >= server->lease) RemoveServer(server);
  }
}

}  // namespace craftfleet
