#include "learner/server_registry.h"

#include <iterator>

namespace craftfleet {

void ServerRegistry::Announce(absl::string_view name, absl::string_view address) {
  const MutexLock lock(&mu_);
  const std::string key(name);
  for (auto entry = servers_.begin(); entry != servers_.end();) {
    const bool replaced = entry->second.address == address && entry->first != key;
    entry = replaced ? servers_.erase(entry) : std::next(entry);
  }
  Entry& entry = servers_[key];
  if (entry.address != address) ++generation_;
  entry = {std::string(address), clock_->Now()};
}

void ServerRegistry::Leave(absl::string_view name) {
  const MutexLock lock(&mu_);
  if (servers_.erase(std::string(name)) > 0) ++generation_;
}

std::vector<ServerRegistry::Server> ServerRegistry::Servers(int64_t* generation) {
  const MutexLock lock(&mu_);
  ForgetIdle();
  std::vector<Server> servers;
  for (const auto& [name, entry] : servers_) servers.push_back({name, entry.address, clock_->Now() - entry.last_word});
  if (generation != nullptr) *generation = generation_;
  return servers;
}

void ServerRegistry::ForgetIdle() {
  for (auto entry = servers_.begin(); entry != servers_.end();) {
    const bool idle = clock_->Now() - entry->second.last_word >= lease_;
    if (idle) ++generation_;
    entry = idle ? servers_.erase(entry) : std::next(entry);
  }
}

}  // namespace craftfleet
