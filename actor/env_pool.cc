#include "actor/env_pool.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/time/clock.h>
#include <absl/types/optional.h>

#include "actor/trouble.h"
#include "common/check.h"
#include "common/log.h"
#include "common/process_usage.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kConnectTimeout = absl::Seconds(3);
constexpr absl::Duration kMoment = absl::Milliseconds(200);
constexpr int64_t kKeptFiles = 128;  // descriptors for everything else; gRPC bears badly to be without
constexpr int64_t kFilesOfServer = 2;

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

EnvPool::EnvPool(std::shared_ptr<EnvDirectory> directory, const v1::SessionHello& hello, int frame_bytes, size_t first)
    : directory_(std::move(directory)), hello_(hello), frame_bytes_(frame_bytes), first_(first) {
  FollowDirectory();
}

std::vector<int> EnvPool::Refresh() {
  std::vector<int> closed = FollowDirectory();
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
    servers_.back()->client = std::make_unique<EnvClient>(endpoint, hello_, frame_bytes_);
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

absl::Status EnvPool::Open(absl::Span<const EnvClient::Lane> lanes, std::string* frames, std::vector<int>* lost) {
  lost->clear();
  std::vector<int> numbers;
  for (const EnvClient::Lane& lane : lanes) numbers.push_back(lane.lane);
  std::vector<int> rows(lanes.size());
  std::iota(rows.begin(), rows.end(), 0);
  frames->resize(lanes.size() * frame_bytes_);
  absl::Status status = CloseOpenOnes(numbers, lost);
  while (status.ok() && !rows.empty()) {
    status = ConnectServers();
    if (status.ok()) status = Spread(lanes, frames, &rows, lost);
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
  if (MayPass(why)) LogWarning("%s; its %d games go on from their snapshots", why.message(), server.lanes);
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
  return MayPass(why) ? absl::OkStatus() : why;
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

absl::Status EnvPool::Spread(absl::Span<const EnvClient::Lane> lanes, std::string* frames, std::vector<int>* rows,
                             std::vector<int>* lost) {
  std::vector<std::vector<int>> by_server(servers_.size());
  for (const int row : *rows) {
    const size_t server = LeastLoaded();
    by_server[server].push_back(row);
    server_of_[lanes[row].lane] = server;
    ++servers_[server]->lanes;
  }
  rows->clear();
  for (size_t server = 0; server < servers_.size(); ++server) {
    if (by_server[server].empty()) continue;
    const absl::Status status = OpenOn(server, lanes, by_server[server], frames);
    if (status.ok()) continue;
    CRAFTFLEET_RETURN_IF_ERROR(Lose(server, status, lost));
    servers_[server]->next_try = absl::Now() + servers_[server]->backoff.Next();
    rows->insert(rows->end(), by_server[server].begin(), by_server[server].end());
  }
  return absl::OkStatus();
}

absl::Status EnvPool::OpenOn(size_t server, absl::Span<const EnvClient::Lane> lanes, absl::Span<const int> rows,
                             std::string* frames) {
  std::vector<EnvClient::Lane> here;
  for (const int row : rows) here.push_back(lanes[row]);
  std::string here_frames;
  CRAFTFLEET_RETURN_IF_ERROR(servers_[server]->client->Open(here, &here_frames));
  for (size_t i = 0; i < rows.size(); ++i) {
    frames->replace(static_cast<size_t>(rows[i]) * frame_bytes_, frame_bytes_, here_frames, i * frame_bytes_,
                    frame_bytes_);
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
  return batch->rewards.empty() ? all : absl::OkStatus();
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
    report.push_back(
        {server->client->address(), server->client->connected(), server->lanes, server->client->summary()});
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

void EnvPool::ConnectReachable() {
  std::vector<Server*> due;
  for (const auto& server : servers_) {
    if (!server->client->connected() && absl::Now() >= server->next_try) due.push_back(server.get());
  }
  int64_t files_left = due.empty() ? 0 : FilesLeft();
  for (Server* server : due) {
    files_left -= kFilesOfServer;
    if (files_left < kKeptFiles) {
      TryLater(server, absl::ResourceExhaustedError(absl::StrCat("environment server ", server->client->address(),
                                                                 ": left out, too many files are open; raise the "
                                                                 "limit (ulimit -n), or name fewer servers")));
    } else if (server->client->Reachable()) {
      Connect(server, absl::ZeroDuration());
    } else if (server->client->Failing() && server->trouble.ok()) {
      Note(server, absl::UnavailableError(absl::StrCat("environment server ", server->client->address(),
                                                       ": not reachable; it gets games as soon as it is")));
    }
  }
}

absl::Status EnvPool::ConnectServers() {
  ConnectReachable();
  if (AnyConnected()) return absl::OkStatus();
  // Nobody waits for a server that does not answer while there is another, but for a moment, so that the first games
  // are spread over all of them.
  absl::Time patience_ends = absl::InfiniteFuture();
  for (const auto& server : servers_) {
    const absl::Time now = absl::Now();
    if (now < server->next_try || now >= patience_ends) continue;
    Connect(server.get(), std::min(kConnectTimeout, patience_ends - now));
    if (server->client->connected()) patience_ends = std::min(patience_ends, absl::Now() + kMoment);
  }
  if (AnyConnected()) return absl::OkStatus();
  if (servers_.empty()) return absl::UnavailableError("no environment server is known yet");
  const bool may_pass =
      std::any_of(servers_.begin(), servers_.end(), [](const auto& server) { return MayPass(server->trouble); });
  if (!may_pass) return servers_.front()->trouble;
  return absl::UnavailableError(absl::StrJoin(
      servers_, "; ", [](std::string* out, const auto& server) { absl::StrAppend(out, server->trouble.message()); }));
}

void EnvPool::Connect(Server* server, absl::Duration timeout) {
  const absl::Status status = server->client->Connect(timeout);
  if (!status.ok()) {
    TryLater(server, status);
    return;
  }
  server->backoff.Reset();
  server->trouble = absl::OkStatus();
}

void EnvPool::TryLater(Server* server, const absl::Status& trouble) {
  server->next_try = absl::Now() + server->backoff.Next();
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

size_t EnvPool::LeastLoaded() const {
  size_t best = servers_.size();
  for (size_t k = 0; k < servers_.size(); ++k) {
    const size_t i = (first_ + k) % servers_.size();
    if (!servers_[i]->client->connected()) continue;
    if (best == servers_.size() || servers_[i]->lanes < servers_[best]->lanes) best = i;
  }
  CRAFTFLEET_CHECK(best < servers_.size());
  return best;
}

}  // namespace craftfleet
