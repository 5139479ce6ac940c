#include "learner/server_registry.h"

#include <algorithm>
#include <iterator>

namespace craftfleet {
namespace {

constexpr absl::Duration kLookEvery = absl::Seconds(1);

}  // namespace

void ServerRegistry::Announce(absl::string_view name, absl::string_view address, int lanes) {
  const MutexLock lock(&mu_);
  ForgetIdleNowAndThen();  // here too, since there may be nobody who asks for servers
  const auto [entry, is_new] = servers_.try_emplace(std::string(address));
  if (is_new) ++generation_;
  Entry& server = entry->second;
  if (!is_new && server.draining && server.name != name) ++generation_;  // another process, which takes games
  server.draining = server.draining && server.name == name;
  server.empty = server.draining && lanes == 0;
  server.name = std::string(name);
  server.last_word = clock_->Now();
}

void ServerRegistry::Leave(absl::string_view name) {
  const MutexLock lock(&mu_);
  const auto entry = Find(name);
  if (entry == servers_.end()) return;
  servers_.erase(entry);
  ++generation_;
}

void ServerRegistry::Drain(absl::string_view name) {
  const MutexLock lock(&mu_);
  const auto entry = Find(name);
  if (entry == servers_.end() || entry->second.draining) return;
  entry->second.draining = true;
  ++generation_;
}

bool ServerRegistry::IsDrained(absl::string_view name) {
  const MutexLock lock(&mu_);
  ForgetIdle();
  const auto entry = Find(name);
  return entry == servers_.end() || entry->second.empty;
}

int64_t ServerRegistry::Generation() {
  const MutexLock lock(&mu_);
  ForgetIdleNowAndThen();
  return generation_;
}

std::vector<ServerRegistry::Server> ServerRegistry::Servers(int64_t* generation) {
  const MutexLock lock(&mu_);
  std::vector<Server> servers = List(/*with_draining=*/false);
  if (generation != nullptr) *generation = generation_;
  return servers;
}

std::vector<ServerRegistry::Server> ServerRegistry::All() {
  const MutexLock lock(&mu_);
  return List(/*with_draining=*/true);
}

std::vector<ServerRegistry::Server> ServerRegistry::List(bool with_draining) {
  ForgetIdle();
  std::vector<Server> servers;
  for (const auto& [address, entry] : servers_) {
    if (entry.draining && !with_draining) continue;
    servers.push_back({entry.name, address, clock_->Now() - entry.last_word, entry.draining});
  }
  return servers;
}

std::map<std::string, ServerRegistry::Entry, std::less<>>::iterator ServerRegistry::Find(absl::string_view name) {
  return std::find_if(servers_.begin(), servers_.end(),
                      [name](const auto& server) { return server.second.name == name; });
}

void ServerRegistry::ForgetIdleNowAndThen() {
  if (clock_->Now() - looked_ >= kLookEvery) ForgetIdle();
}

void ServerRegistry::ForgetIdle() {
  looked_ = clock_->Now();
  for (auto entry = servers_.begin(); entry != servers_.end();) {
    const bool idle = looked_ - entry->second.last_word >= lease_;
    if (idle) ++generation_;
    entry = idle ? servers_.erase(entry) : std::next(entry);
  }
}

}  // namespace craftfleet
