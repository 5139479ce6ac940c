#include "learner/scheduling/server_reports.h"

#include <algorithm>

#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

// How long an actor must be unable to use any server of its list until it gets others; and within which time it
// reports each of them again.
constexpr absl::Duration kUnusableFor = absl::Seconds(3);
constexpr absl::Duration kReportedAgain = absl::Seconds(20);

}  // namespace

void ServerReports::Add(const ServerReport& report) {
  const absl::Time now = clock_->Now();
  Worker* server = workers_->FindServer(report.address);
  const bool reports_itself = server != nullptr;
  if (!reports_itself) server = RecordOf(report.address);
  if (server == nullptr) return;
  if (report.hangs) server->not_answering = now;
  if (report.slow) NoteSlow(report.step_ms, server);
  if (reports_itself) return;
  if (report.answers) server->last_seen = now;
  if (report.summary == nullptr) return;
  server->summary = report.summary;
  server->summary_time = now;
}

Worker* ServerReports::RecordOf(const std::string& address) {
  Worker* server = workers_->Find(WorkerRole::kEnvServer, address);
  if (server == nullptr) {
    const auto is_full = [this] {
      const auto& workers = workers_->workers();
      return std::count_if(workers.begin(), workers.end(),
                           [](const auto& entry) { return entry.second.IsOnlyReported(); }) >= kMaxReported;
    };
    if (is_full()) workers_->Prune();
    if (is_full()) return nullptr;
    server = workers_->Record(WorkerRole::kEnvServer, address);
  }
  if (server->last_seen == absl::InfinitePast()) {
    server->address = address;
    server->last_seen = clock_->Now() - WorkerTable::kRelayed;
  }
  return server;
}

void ServerReports::NoteSlow(double step_ms, Worker* server) {
  const absl::Time now = clock_->Now();
  if (now - server->slow >= WorkerTable::kRelayed) {
    LogWarning("environment server %s is slow: a step takes %.0f ms", server->address, step_ms);
  }
  server->slow = now;
  server->step_ms = step_ms;
}

void ServerReports::AddUnusable(const std::string& address, Worker* actor) {
  if (workers_->FindServer(address) == nullptr) return;
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

bool ServerReports::LacksServers(const Worker& actor, const std::set<std::string>& addresses) const {
  const absl::Time now = clock_->Now();
  return !addresses.empty() && std::all_of(addresses.begin(), addresses.end(), [&](const std::string& address) {
    const auto unusable = actor.unusable.find(address);
    return unusable != actor.unusable.end() && now - unusable->second.reported <= kReportedAgain &&
           unusable->second.reported - unusable->second.since >= kUnusableFor;
  });
}

std::optional<ServerLists::List> ServerReports::NewList(int64_t generation, Worker* actor) {
  ServerLists& lists = workers_->lists();
  // Later than all of this start: the date was set back since.
  const bool is_of_earlier_start = generation < first_generation_ || generation > lists.last_generation();
  const bool keeps = generation != 0 && is_of_earlier_start && clock_->Now() - start_ < server_lease_;
  if (keeps) return std::nullopt;
  const ServerLists::List* list = &lists.ListOf(actor->name, actor->client.host);
  if (LacksServers(*actor, list->addresses)) {
    lists.Avoid(actor->name);
    actor->unusable.clear();
    list = &lists.ListOf(actor->name, actor->client.host);
  }
  if (list->generation == generation) return std::nullopt;
  return *list;
}

}  // namespace craftfleet
