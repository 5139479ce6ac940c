#include "actor/env_pool.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "actor/error_policy.h"
#include "common/check.h"
#include "common/clock.h"
#include "common/log.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

template <typename T>
void AppendTo(std::vector<T>* all, std::vector<T>* part) {
  std::move(part->begin(), part->end(), std::back_inserter(*all));
}

// Empties `batch`, keeping its buffers.
void Clear(StepBatch* batch) {
  batch->frames.clear();
  batch->last_frames.clear();
  batch->rewards.clear();
  batch->ends.clear();
  batch->episodes.clear();
  batch->snapshots.clear();
}

}  // namespace

EnvPool::EnvPool(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes, size_t first,
                 std::shared_ptr<ServerHealth> health)
    : directory_(std::move(directory)),
      hello_(hello),
      frame_bytes_(frame_bytes),
      first_(first),
      health_(health != nullptr ? std::move(health)
                                : std::make_shared<ServerHealth>(ServerHealth::Options{hello, frame_bytes})) {
  FollowDirectory();
}

std::vector<int> EnvPool::Refresh() {
  std::vector<int> closed = FollowDirectory();
  // Trouble that does not pass is met again when the games are opened.
  LoseSuspects(&closed).IgnoreError();
  ConnectReachable();
  Balance(&closed);
  return closed;
}

std::vector<int> EnvPool::FollowDirectory() {
  if (generation_ == directory_->generation()) return {};
  generation_ = directory_->generation();
  std::vector<std::unique_ptr<Server>> servers;
  const MutexLock lock(&mu_);
  servers.swap(servers_);
  std::map<size_t, size_t> index_now;  // of servers that stay, by the one they had
  for (const wire::Endpoint& endpoint : directory_->Servers()) {
    const auto known = std::find_if(servers.begin(), servers.end(), [&](const auto& server) {
      return server != nullptr && server->client->address() == endpoint.address;
    });
    if (known != servers.end()) {
      index_now[known - servers.begin()] = servers_.size();
      servers_.push_back(std::move(*known));
      continue;
    }
    servers_.push_back(std::make_unique<Server>());
    servers_.back()->client = std::make_unique<EnvClient>(endpoint, hello_, frame_bytes_, health_->timeout());
    if (cancelled_) servers_.back()->client->Cancel();
  }
  std::vector<int> closed;
  std::map<int, size_t> server_of;
  for (const auto& [lane, server] : server_of_) {
    if (const auto now = index_now.find(server); now != index_now.end()) {
      server_of[lane] = now->second;
    } else {
      closed.push_back(lane);
    }
  }
  server_of_ = std::move(server_of);
  return closed;
}

void EnvPool::Balance(std::vector<int>* closed) {
  std::vector<int> counts;  // of games, as they will be
  for (const auto& server : servers_) counts.push_back(server->lanes);
  std::map<int, size_t> staying = server_of_;
  std::vector<int> moving;
  while (true) {
    absl::optional<size_t> fullest;
    absl::optional<size_t> emptiest;
    for (size_t i = 0; i < servers_.size(); ++i) {
      if (!servers_[i]->client->connected()) continue;
      if (!fullest.has_value() || counts[i] > counts[*fullest]) fullest = i;
      if (!emptiest.has_value() || counts[i] < counts[*emptiest]) emptiest = i;
    }
    if (!fullest.has_value() || counts[*fullest] < counts[*emptiest] + 2) break;
    const auto lane =
        std::find_if(staying.begin(), staying.end(), [&](const auto& entry) { return entry.second == *fullest; });
    moving.push_back(lane->first);
    staying.erase(lane);
    --counts[*fullest];
    ++counts[*emptiest];
  }
  closed->insert(closed->end(), moving.begin(), moving.end());
  // Trouble that does not pass is met again when the games are opened.
  CloseOpenOnes(moving, closed).IgnoreError();
}

absl::Status EnvPool::Open(absl::Span<const EnvClient::Lane> lanes, std::string* frames, std::vector<int>* lost,
                           std::vector<EnvClient::Refused>* refused) {
  lost->clear();
  refused->clear();
  std::vector<int> numbers;
  for (const EnvClient::Lane& lane : lanes) numbers.push_back(lane.lane);
  Opening opening = {lanes, frames, lost, refused, std::vector<int>(lanes.size()), {}};
  std::iota(opening.rows.begin(), opening.rows.end(), 0);
  frames->resize(lanes.size() * frame_bytes_);
  absl::Status status = CloseOpenOnes(numbers, lost);
  while (status.ok() && !opening.rows.empty()) {
    status = ConnectServers();
    if (status.ok()) status = Spread(&opening);
  }
  if (!status.ok()) Reset();
  // What was lost on the way and is open by now.
  lost->erase(std::remove_if(lost->begin(), lost->end(), [this](int lane) { return server_of_.count(lane) > 0; }),
              lost->end());
  return status;
}

absl::Status EnvPool::Close(absl::Span<const int> lanes, std::vector<int>* lost) {
  lost->clear();
  absl::Status status = CloseOpenOnes(lanes, lost);
  if (!status.ok()) Reset();
  return status;
}

absl::Status EnvPool::Lose(size_t index, const absl::Status& why, std::vector<int>* lost) {
  Server& server = *servers_[index];
  const bool stopping = cancelled();
  if (!stopping) {
    LogWarning("%s; its %d games go on from their snapshots", why.message(), server.lanes);
    if (ReactionTo(Called::kSession, why) == Reaction::kLeaveAlone) health_->Suspect(server.client->server(), why);
  }
  server.client->Disconnect();
  server.trouble = why;
  server.lanes = 0;
  for (auto entry = server_of_.begin(); entry != server_of_.end();) {
    if (entry->second != index) {
      ++entry;
      continue;
    }
    lost->push_back(entry->first);
    entry = server_of_.erase(entry);
  }
  return stopping ? absl::CancelledError("stopping") : absl::OkStatus();
}

absl::Status EnvPool::LoseSuspects(std::vector<int>* lost) {
  for (size_t i = 0; i < servers_.size(); ++i) {
    if (!servers_[i]->client->connected()) continue;
    const absl::Status trouble = health_->TroubleOf(servers_[i]->client->address());
    if (!trouble.ok()) CRAFTFLEET_RETURN_IF_ERROR(Lose(i, trouble, lost));
  }
  return absl::OkStatus();
}

absl::Status EnvPool::CloseOpenOnes(absl::Span<const int> lanes, std::vector<int>* lost) {
  std::vector<std::vector<int>> by_server(servers_.size());
  for (const int lane : lanes) {
    if (const auto found = server_of_.find(lane); found != server_of_.end()) by_server[found->second].push_back(lane);
  }
  for (size_t i = 0; i < servers_.size(); ++i) {
    if (by_server[i].empty()) continue;
    const absl::Status status = servers_[i]->client->Close(by_server[i]);
    servers_[i]->lanes -= static_cast<int>(by_server[i].size());
    for (const int lane : by_server[i]) server_of_.erase(lane);
    if (!status.ok()) CRAFTFLEET_RETURN_IF_ERROR(Lose(i, status, lost));
  }
  return absl::OkStatus();
}

absl::Status EnvPool::Spread(Opening* opening) {
  std::vector<std::vector<int>> by_server(servers_.size());
  for (const int row : std::exchange(opening->rows, {})) {
    const auto refusal = opening->refusals.find(row);
    const bool was_refused = refusal != opening->refusals.end();
    const absl::optional<size_t> server =
        LeastLoaded(was_refused ? absl::make_optional(refusal->second.server) : absl::nullopt);
    if (!server.has_value()) {  // nobody else to ask
      opening->refused->push_back({opening->lanes[row].lane, refusal->second.reason});
      continue;
    }
    by_server[*server].push_back(row);
    server_of_[opening->lanes[row].lane] = *server;
    ++servers_[*server]->lanes;
  }
  for (size_t server = 0; server < servers_.size(); ++server) {
    std::vector<int>& rows = by_server[server];
    if (rows.empty()) continue;
    const std::vector<int> all = rows;
    std::vector<std::string> reasons;
    const absl::Status status = OpenOn(server, *opening, &rows, &reasons);
    if (!status.ok()) {
      CRAFTFLEET_RETURN_IF_ERROR(Lose(server, status, opening->lost));
      servers_[server]->next_try = SteadyNow() + servers_[server]->backoff.Next();
      opening->rows.insert(opening->rows.end(), all.begin(), all.end());
      continue;
    }
    TakeRefused(server, rows, reasons, opening);
    CRAFTFLEET_RETURN_IF_ERROR(BlameRefusals(server, all, opening));
  }
  return absl::OkStatus();
}

absl::Status EnvPool::OpenOn(size_t server, const Opening& opening, std::vector<int>* rows,
                             std::vector<std::string>* reasons) {
  std::vector<EnvClient::Lane> here;
  for (const int row : *rows) here.push_back(opening.lanes[row]);
  std::string frames;
  std::vector<EnvClient::Refused> refused;
  CRAFTFLEET_RETURN_IF_ERROR(servers_[server]->client->Open(here, &frames, &refused));
  size_t opened = 0;
  std::vector<int> left;
  for (const int row : *rows) {
    const int lane = opening.lanes[row].lane;
    if (left.size() < refused.size() && refused[left.size()].lane == lane) {
      reasons->push_back(refused[left.size()].reason);
      left.push_back(row);
      continue;
    }
    opening.frames->replace(static_cast<size_t>(row) * frame_bytes_, frame_bytes_, frames, opened * frame_bytes_,
                            frame_bytes_);
    ++opened;
  }
  *rows = std::move(left);
  return absl::OkStatus();
}

void EnvPool::TakeRefused(size_t server, const std::vector<int>& rows, const std::vector<std::string>& reasons,
                          Opening* opening) {
  for (size_t i = 0; i < rows.size(); ++i) {
    const int lane = opening->lanes[rows[i]].lane;
    server_of_.erase(lane);
    --servers_[server]->lanes;
    const std::string reason = absl::StrCat(servers_[server]->client->address(), ": ", reasons[i]);
    if (opening->refusals.try_emplace(rows[i], Refusal{server, reason}).second) {
      opening->rows.push_back(rows[i]);
    } else {  // two servers agree
      opening->refused->push_back({lane, CutReason(reason)});
    }
  }
}

absl::Status EnvPool::BlameRefusals(size_t server, absl::Span<const int> opened, Opening* opening) {
  for (const int row : opened) {
    const auto refusal = opening->refusals.find(row);
    const auto now_on = server_of_.find(opening->lanes[row].lane);
    if (refusal == opening->refusals.end() || now_on == server_of_.end() || now_on->second != server) continue;
    const size_t liar = refusal->second.server;
    if (liar == server || !servers_[liar]->client->connected()) continue;
    CRAFTFLEET_RETURN_IF_ERROR(
        Lose(liar,
             absl::DataLossError(absl::StrFormat("environment server %s: refused the snapshot of lane %d, which %s "
                                                 "takes",
                                                 servers_[liar]->client->address(), opening->lanes[row].lane,
                                                 servers_[server]->client->address())),
             opening->lost));
  }
  return absl::OkStatus();
}

std::vector<int> EnvPool::Arrange(std::vector<int> lanes) const {
  std::stable_sort(lanes.begin(), lanes.end(), [this](int a, int b) { return server_of_.at(a) < server_of_.at(b); });
  return lanes;
}

absl::Status EnvPool::Step(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot,
                           StepBatch* batch, std::vector<int>* lost) {
  lost->clear();
  absl::Status status = SendAndReceive(lanes, actions, snapshot, batch, lost);
  if (!status.ok()) Reset();
  return status;
}

absl::Status EnvPool::SendAndReceive(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot,
                                     StepBatch* batch, std::vector<int>* lost) {
  std::vector<absl::Status> statuses(servers_.size());
  for (size_t i = 0; i < servers_.size(); ++i) {
    const auto [first, last] = RowsOn(i, lanes);
    if (first == last) continue;
    statuses[i] = servers_[i]->client->SendStep(lanes.subspan(first, last - first),
                                                actions.subspan(first, last - first), snapshot);
  }
  Clear(batch);
  busy_ = absl::ZeroDuration();
  for (size_t i = 0; i < servers_.size(); ++i) {
    const auto [first, last] = RowsOn(i, lanes);
    if (first == last || !statuses[i].ok()) continue;
    StepBatch& part = servers_[i]->batch;
    statuses[i] = servers_[i]->client->ReceiveStep(&part);
    if (!statuses[i].ok()) continue;
    busy_ = std::max(busy_, servers_[i]->client->busy());
    if (last - first == lanes.size()) {  // the only one: no copy
      std::swap(*batch, part);
      return absl::OkStatus();
    }
    batch->frames.append(part.frames);
    batch->last_frames.append(part.last_frames);
    AppendTo(&batch->rewards, &part.rewards);
    AppendTo(&batch->ends, &part.ends);
    AppendTo(&batch->episodes, &part.episodes);
    AppendTo(&batch->snapshots, &part.snapshots);
  }
  absl::Status all;
  for (size_t i = 0; i < servers_.size(); ++i) {
    if (statuses[i].ok()) continue;
    CRAFTFLEET_RETURN_IF_ERROR(Lose(i, statuses[i], lost));
    all.Update(statuses[i]);
  }
  // Whatever they said of it: there may be others.
  return batch->rewards.empty() ? absl::UnavailableError(all.message()) : absl::OkStatus();
}

std::pair<size_t, size_t> EnvPool::RowsOn(size_t server, absl::Span<const int> lanes) const {
  const auto before = [this](int lane, size_t s) { return server_of_.at(lane) < s; };
  const auto first = std::lower_bound(lanes.begin(), lanes.end(), server, before);
  const auto last = std::lower_bound(first, lanes.end(), server + 1, before);
  return {first - lanes.begin(), last - lanes.begin()};
}

std::vector<ServerBook::Server> EnvPool::Report() const {
  std::vector<ServerBook::Server> report;
  for (const auto& server : servers_) {
    const EnvClient& client = *server->client;
    report.push_back({client.address(), client.connected(), server->lanes, client.summary(),
                      std::string(health_->TroubleOf(client.address()).message())});
  }
  return report;
}

void EnvPool::Reset() {
  for (const auto& server : servers_) {
    server->client->Disconnect();
    server->lanes = 0;
  }
  server_of_.clear();
}

void EnvPool::Cancel() {
  const MutexLock lock(&mu_);
  cancelled_ = true;
  for (const auto& server : servers_) server->client->Cancel();
}

absl::optional<size_t> EnvPool::LeastLoaded(absl::optional<size_t> except) const {
  absl::optional<size_t> best;
  for (size_t k = 0; k < servers_.size(); ++k) {
    const size_t i = (first_ + k) % servers_.size();
    if (!servers_[i]->client->connected() || i == except) continue;
    if (!best.has_value() || servers_[i]->lanes < servers_[*best]->lanes) best = i;
  }
  CRAFTFLEET_CHECK(best.has_value() || except.has_value());
  return best;
}

}  // namespace craftfleet
