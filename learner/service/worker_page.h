// Converts workers' reports from messages, and workers to peers of status replies.

#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "craftfleet/v1/status.pb.h"
#include "learner/scheduling/worker_registry.h"

namespace craftfleet {

// Copies a worker's summary. Null: it is empty.
std::shared_ptr<const v1::ProcessSummary> KeepSummary(const v1::ProcessSummary& summary);

// Converts an actor's report on an environment server.
ServerReport ToServerReport(const v1::Peer& server);

// Names as in status.proto.
std::string RoleName(WorkerRole role);
v1::Peer::Health ToProto(WorkerRegistry::Health health);

inline constexpr size_t kMaxPeers = 1000;  // on a status page: more would take long, and nobody reads them

// Adds workers as peers, at most kMaxPeers, and the metric workers_mixed. Returns all workers, for sums.
std::vector<WorkerRegistry::WorkerInfo> AddWorkers(const WorkerRegistry& registry, v1::StatusReply* reply);

}  // namespace craftfleet
