#include "actor/env_pool.h"

#include <algorithm>
#include <numeric>
#include <optional>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "actor/error_policy.h"
#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// Consecutive lanes on one server: rows [first, last) of a step.
struct Rows {
  size_t first = 0;
  size_t last = 0;
  absl::Status status;  // of the step
};

}  // namespace

EnvPool::EnvPool(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes, size_t first,
                 std::shared_ptr<ServerHealth> health)
    : frame_bytes_(frame_bytes),
      connections_(std::move(directory), hello, frame_bytes,
                   health != nullptr ? std::move(health)
                                     : std::make_shared<ServerHealth>(ServerHealth::Options{hello, frame_bytes})),
      placement_(first) {
  connections_.Follow();
  placement_.SetServers(connections_.Addresses());
}

std::vector<int> EnvPool::Refresh() {
  std::vector<int> closed;
  if (connections_.Follow()) closed = placement_.SetServers(connections_.Addresses());
  // Errors are ignored here and below: a lasting one occurs again when the games are opened.
  DropSuspects(&closed).IgnoreError();
  connections_.ConnectReachable();
  UpdateAvailability();
  const std::vector<int> moving = placement_.Excess();
  closed.insert(closed.end(), moving.begin(), moving.end());
  CloseOpenOnes(moving, &closed).IgnoreError();
  return closed;
}

void EnvPool::UpdateAvailability() {
  for (size_t i = 0; i < connections_.size(); ++i) placement_.SetAvailable(i, connections_.client(i).connected());
}

absl::Status EnvPool::ConnectAny() {
  absl::Status status = connections_.ConnectAny();
  UpdateAvailability();
  return status;
}

absl::StatusOr<EnvPool::Opened> EnvPool::Open(absl::Span<const EnvClient::Lane> lanes) {
  Opening opening = {lanes, {}, std::vector<size_t>(lanes.size()), {}};
  std::iota(opening.rows.begin(), opening.rows.end(), 0);
  std::vector<int> numbers;
  for (const EnvClient::Lane& lane : lanes) {
    numbers.push_back(lane.lane);
    opening.result.lanes.push_back({lane.lane});
  }
  std::vector<int>& lost = opening.result.lost;
  absl::Status status = CloseOpenOnes(numbers, &lost);
  while (status.ok() && !opening.rows.empty()) {
    status = ConnectAny();
    if (status.ok()) status = Spread(&opening);
  }
  if (!status.ok()) {
    Reset();
    return status;
  }
  // Some lanes lost in the meantime have been opened again.
  lost.erase(
      std::remove_if(lost.begin(), lost.end(), [this](int lane) { return placement_.ServerOf(lane).has_value(); }),
      lost.end());
  return std::move(opening.result);
}

absl::StatusOr<std::vector<int>> EnvPool::Close(absl::Span<const int> lanes) {
  std::vector<int> lost;
  if (absl::Status status = CloseOpenOnes(lanes, &lost); !status.ok()) {
    Reset();
    return status;
  }
  return lost;
}

absl::Status EnvPool::Lose(size_t server, const absl::Status& why, std::vector<int>* lost) {
  const std::vector<int> lanes = placement_.Lose(server);
  lost->insert(lost->end(), lanes.begin(), lanes.end());
  return connections_.Drop(server, why, static_cast<int>(lanes.size()));
}

absl::Status EnvPool::DropSuspects(std::vector<int>* lost) {
  for (size_t i = 0; i < connections_.size(); ++i) {
    if (!connections_.client(i).connected()) continue;
    const ServerHealth::View health = connections_.HealthOf(i);
    if (connections_.MustLeave(health)) CRAFTFLEET_RETURN_IF_ERROR(Lose(i, health.error, lost));
  }
  return absl::OkStatus();
}

absl::Status EnvPool::CloseOpenOnes(absl::Span<const int> lanes, std::vector<int>* lost) {
  const std::vector<std::vector<int>> by_server = placement_.ByServer(lanes);
  for (size_t i = 0; i < by_server.size(); ++i) {
    if (by_server[i].empty()) continue;
    const absl::Status status = connections_.client(i).Close(by_server[i]);
    for (const int lane : by_server[i]) placement_.Remove(lane);
    if (!status.ok()) CRAFTFLEET_RETURN_IF_ERROR(Lose(i, status, lost));
  }
  return absl::OkStatus();
}

absl::Status EnvPool::Spread(Opening* opening) {
  std::vector<std::vector<size_t>> by_server(connections_.size());
  for (const size_t row : std::exchange(opening->rows, {})) {
    const auto refusal = opening->refusals.find(row);
    const bool was_refused = refusal != opening->refusals.end();
    const std::optional<size_t> server = placement_.Place(
        opening->lanes[row].lane, was_refused ? std::make_optional(refusal->second.server) : std::nullopt);
    if (server.has_value()) {
      by_server[*server].push_back(row);
    } else {  // there is no other server
      CRAFTFLEET_CHECK(was_refused);
      opening->result.lanes[row].refusal = refusal->second.reason;
    }
  }
  for (size_t server = 0; server < by_server.size(); ++server) {
    const std::vector<size_t>& rows = by_server[server];
    if (rows.empty()) continue;
    const absl::StatusOr<std::map<size_t, std::string>> reasons = OpenOn(server, rows, opening);
    if (!reasons.ok()) {
      CRAFTFLEET_RETURN_IF_ERROR(Lose(server, reasons.status(), &opening->result.lost));
      connections_.Postpone(server);
      opening->rows.insert(opening->rows.end(), rows.begin(), rows.end());
      continue;
    }
    HandleRefusals(server, *reasons, opening);
    CRAFTFLEET_RETURN_IF_ERROR(BlameRefusals(server, rows, opening));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::map<size_t, std::string>> EnvPool::OpenOn(size_t server, const std::vector<size_t>& rows,
                                                              Opening* opening) {
  std::vector<EnvClient::Lane> here;
  for (const size_t row : rows) here.push_back(opening->lanes[row]);
  std::string frames;
  std::vector<EnvClient::Refused> refused;  // in the order of `here`
  CRAFTFLEET_RETURN_IF_ERROR(connections_.client(server).Open(here, &frames, &refused));
  std::map<size_t, std::string> reasons;
  size_t opened = 0;
  for (const size_t row : rows) {
    OpenedLane& lane = opening->result.lanes[row];
    if (reasons.size() < refused.size() && refused[reasons.size()].lane == lane.lane) {
      const std::string& reason = refused[reasons.size()].reason;
      reasons[row] = absl::StrCat(connections_.client(server).address(), ": ", reason);
    } else {
      std::vector<std::string>& records = connections_.client(server).records();
      if (!records.empty()) lane.record = std::move(records[opened]);
      lane.frame.assign(frames, opened++ * frame_bytes_, frame_bytes_);
    }
  }
  return reasons;
}

void EnvPool::HandleRefusals(size_t server, const std::map<size_t, std::string>& reasons, Opening* opening) {
  for (const auto& [row, reason] : reasons) {
    placement_.Remove(opening->lanes[row].lane);
    if (opening->refusals.try_emplace(row, Refusal{server, reason}).second) {
      opening->rows.push_back(row);
    } else {  // two servers agree
      opening->result.lanes[row].refusal = CutReason(reason);
    }
  }
}

absl::Status EnvPool::BlameRefusals(size_t server, const std::vector<size_t>& rows, Opening* opening) {
  for (const size_t row : rows) {
    const int lane = opening->lanes[row].lane;
    const auto refusal = opening->refusals.find(row);
    if (refusal == opening->refusals.end() || placement_.ServerOf(lane) != server) continue;
    const size_t liar = refusal->second.server;
    if (liar == server || !connections_.client(liar).connected()) continue;
    const absl::Status why = absl::DataLossError(
        absl::StrFormat("environment server %s: refused the snapshot of lane %d, which %s accepts",
                        connections_.client(liar).address(), lane, connections_.client(server).address()));
    CRAFTFLEET_RETURN_IF_ERROR(Lose(liar, why, &opening->result.lost));
  }
  return absl::OkStatus();
}

absl::StatusOr<EnvPool::Stepped> EnvPool::Step(absl::Span<const int> lanes, absl::Span<const Action> actions,
                                               bool snapshot) {
  absl::StatusOr<Stepped> stepped = SendAndReceive(lanes, actions, snapshot);
  if (!stepped.ok()) Reset();
  return stepped;
}

absl::StatusOr<EnvPool::Stepped> EnvPool::SendAndReceive(absl::Span<const int> lanes, absl::Span<const Action> actions,
                                                         bool snapshot) {
  std::map<size_t, Rows> rows_on;  // by server
  for (size_t row = 0; row < lanes.size(); ++row) {
    Rows& rows = rows_on.try_emplace(*placement_.ServerOf(lanes[row]), Rows{row, row, {}}).first->second;
    rows.last = row + 1;
  }
  batches_.resize(connections_.size());
  const absl::Time sent = SteadyNow();
  for (auto& [server, rows] : rows_on) {
    const size_t count = rows.last - rows.first;
    rows.status = connections_.client(server).SendStep(lanes.subspan(rows.first, count),
                                                       actions.subspan(rows.first, count), snapshot);
  }
  // The quickest first: the time of a server that is read after a slower one can't be measured.
  std::vector<std::pair<absl::Duration, size_t>> order;
  for (const auto& [server, rows] : rows_on) {
    order.emplace_back(connections_.HealthOf(server).step_time.value_or(absl::ZeroDuration()), server);
  }
  std::sort(order.begin(), order.end());
  for (const auto& [step_time, server] : order) {
    Rows& rows = rows_on.at(server);
    if (!rows.status.ok()) continue;
    const absl::Time begun = SteadyNow();
    rows.status = connections_.client(server).ReceiveStep(&batches_[server]);
    const absl::Time end = SteadyNow();
    const bool was_waited_for = end - begun > (end - sent) / 4;  // otherwise its reply was there before
    if (rows.status.ok() && was_waited_for) connections_.NoteStep(server, end - sent);
    // In the middle of a fragment, whose end may be minutes away.
    const ServerHealth::View health = connections_.HealthOf(server);
    if (rows.status.ok() && health.is_slow && connections_.MustLeave(health)) rows.status = health.error;
  }
  Stepped stepped;
  stepped.lanes.reserve(lanes.size());
  for (auto& [server, rows] : rows_on) {
    if (!rows.status.ok()) continue;
    EnvClient& client = connections_.client(server);
    stepped.busy = std::max(stepped.busy, client.busy());
    Append(lanes.subspan(rows.first, rows.last - rows.first), &batches_[server], &client.records(), &stepped);
  }
  absl::Status all;
  for (const auto& [server, rows] : rows_on) {
    if (rows.status.ok()) continue;
    CRAFTFLEET_RETURN_IF_ERROR(Lose(server, rows.status, &stepped.lost));
    all.Update(rows.status);
  }
  // Always Unavailable, since other servers may be available.
  if (stepped.lanes.empty()) return absl::UnavailableError(all.message());
  return stepped;
}

void EnvPool::Append(absl::Span<const int> lanes, StepBatch* batch, std::vector<std::string>* records,
                     Stepped* stepped) const {
  size_t ended = 0;
  size_t truncated = 0;
  for (size_t row = 0; row < lanes.size(); ++row) {
    SteppedLane& lane = stepped->lanes.emplace_back();
    lane.lane = lanes[row];
    lane.reward = batch->rewards[row];
    lane.end = batch->ends[row];
    if (!batch->snapshots.empty()) lane.snapshot = std::move(batch->snapshots[row]);
    if (!records->empty()) lane.record = std::move((*records)[row]);
    if (lane.end != StepEnd::kNone) lane.episode = batch->episodes[ended++];
    if (lane.end == StepEnd::kTruncated) {
      lane.last_frame.assign(batch->last_frames, truncated++ * frame_bytes_, frame_bytes_);
    }
  }
  if (stepped->frames.empty()) {
    stepped->frames.swap(batch->frames);  // usually from the only server: avoids a copy
  } else {
    stepped->frames.append(batch->frames);
  }
}

std::vector<EnvServerTracker::Server> EnvPool::Report() const {
  std::vector<EnvServerTracker::Server> report;
  for (size_t i = 0; i < connections_.size(); ++i) {
    const EnvClient& client = connections_.client(i);
    const ServerHealth::View health = connections_.HealthOf(i);
    report.push_back({client.address(), client.connected() && client.Reachable(), placement_.LanesOn(i),
                      client.summary(), std::string(health.error.message()), health.is_slow,
                      health.step_time.value_or(absl::ZeroDuration())});
  }
  return report;
}

void EnvPool::Reset() {
  connections_.DisconnectAll();
  placement_.Clear();
}

}  // namespace craftfleet
