#include "actor/env_pool.h"

#include <algorithm>
#include <limits>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/time/clock.h>

#include "actor/trouble.h"
#include "common/check.h"
#include "common/log.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kConnectTimeout = absl::Seconds(3);
constexpr absl::Duration kMoment = absl::Milliseconds(200);

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
  for (wire::Endpoint& endpoint : directory_->Servers()) {
    const auto known = std::find_if(servers.begin(), servers.end(), [&](const auto& server) {
      return server != nullptr && server->client->address() == endpoint.address;
    });
    if (known != servers.end()) {
      index_now[known - servers.begin()] = servers_.size();
      servers_.push_back(std::move(*known));
      continue;
    }
    servers_.push_back(std::make_unique<Server>());
    servers_.back()->client = std::make_unique<EnvClient>(std::move(endpoint), hello_, frame_bytes_);
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
  while (true) {
    Server* fullest = nullptr;
    Server* emptiest = nullptr;
    for (const auto& server : servers_) {
      if (!server->client->connected()) continue;
      if (fullest == nullptr || server->lanes > fullest->lanes) fullest = server.get();
      if (emptiest == nullptr || server->lanes < emptiest->lanes) emptiest = server.get();
    }
    if (fullest == nullptr || fullest->lanes < emptiest->lanes + 2) break;
    const auto lane = std::find_if(server_of_.begin(), server_of_.end(),
                                   [&](const auto& entry) { return servers_[entry.second].get() == fullest; });
    // A server that fails at this will be seen to fail at the next step.
    fullest->client->Close({lane->first}).IgnoreError();
    closed->push_back(lane->first);
    server_of_.erase(lane);
    --fullest->lanes;
    ++emptiest->lanes;  // where it will be opened
  }
  for (const auto& server : servers_) server->lanes = 0;
  for (const auto& [lane, server] : server_of_) ++servers_[server]->lanes;
}

absl::Status EnvPool::Open(absl::Span<const EnvClient::Lane> lanes, std::string* frames) {
  std::vector<int> numbers;
  for (const EnvClient::Lane& lane : lanes) numbers.push_back(lane.lane);
  absl::Status status = ConnectServers();
  if (status.ok()) status = CloseOpenOnes(numbers);
  if (status.ok()) status = Spread(lanes, frames);
  if (!status.ok()) Reset();
  return status;
}

absl::Status EnvPool::Close(absl::Span<const int> lanes) {
  absl::Status status = CloseOpenOnes(lanes);
  if (!status.ok()) Reset();
  return status;
}

absl::Status EnvPool::CloseOpenOnes(absl::Span<const int> lanes) {
  for (const int lane : lanes) {
    const auto found = server_of_.find(lane);
    if (found == server_of_.end()) continue;
    Server& server = *servers_[found->second];
    CRAFTFLEET_RETURN_IF_ERROR(server.client->Close({lane}));
    --server.lanes;
    server_of_.erase(found);
  }
  return absl::OkStatus();
}

absl::Status EnvPool::Spread(absl::Span<const EnvClient::Lane> lanes, std::string* frames) {
  std::vector<std::vector<int>> rows(servers_.size());
  for (size_t row = 0; row < lanes.size(); ++row) {
    const size_t server = LeastLoaded();
    rows[server].push_back(static_cast<int>(row));
    server_of_[lanes[row].lane] = server;
    ++servers_[server]->lanes;
  }
  frames->resize(lanes.size() * frame_bytes_);
  for (size_t server = 0; server < servers_.size(); ++server) {
    if (!rows[server].empty()) CRAFTFLEET_RETURN_IF_ERROR(OpenOn(server, lanes, rows[server], frames));
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
                           StepBatch* batch) {
  absl::Status status = SendAndReceive(lanes, actions, snapshot, batch);
  if (!status.ok()) Reset();
  return status;
}

absl::Status EnvPool::SendAndReceive(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot,
                                     StepBatch* batch) {
  for (size_t i = 0; i < servers_.size(); ++i) {
    const auto [first, last] = RowsOn(i, lanes);
    if (first == last) continue;
    CRAFTFLEET_RETURN_IF_ERROR(servers_[i]->client->SendStep(lanes.subspan(first, last - first),
                                                             actions.subspan(first, last - first), snapshot));
  }
  Clear(batch);
  busy_ = absl::ZeroDuration();
  for (size_t i = 0; i < servers_.size(); ++i) {
    const auto [first, last] = RowsOn(i, lanes);
    if (first == last) continue;
    StepBatch& part = servers_[i]->batch;
    CRAFTFLEET_RETURN_IF_ERROR(servers_[i]->client->ReceiveStep(&part));
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
  return absl::OkStatus();
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
  for (const auto& server : servers_) {
    if (server->client->connected() || absl::Now() < server->next_try) continue;
    if (server->client->Reachable()) {
      Connect(server.get(), absl::ZeroDuration());
    } else if (server->client->Failing() && server->trouble.ok()) {
      Note(server.get(), absl::UnavailableError(absl::StrCat("environment server ", server->client->address(),
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
    server->next_try = absl::Now() + server->backoff.Next();
    Note(server, status);
    return;
  }
  server->backoff.Reset();
  server->trouble = absl::OkStatus();
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
