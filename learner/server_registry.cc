#include "learner/server_registry.h"

#include <algorithm>
#include <iterator>

namespace craftfleet {
namespace {

constexpr absl::Duration kLookEvery = absl::Seconds(1);

}  // namespace

void ServerRegistry::Announce(absl::string_view name, absl::string_view address) {
  const MutexLock lock(&mu_);
  // Here too, since there may be nobody who asks for servers; not each time, since there may be thousands of them.
  if (clock_->Now() - looked_ >= kLookEvery) ForgetIdle();
  const auto [entry, is_new] = servers_.try_emplace(std::string(address));
  if (is_new) ++generation_;
  entry->second = {std::string(name), clock_->Now()};
}

void ServerRegistry::Leave(absl::string_view name) {
  const MutexLock lock(&mu_);
  const auto entry =
      std::find_if(servers_.begin(), servers_.end(), [name](const auto& server) { return server.second.name == name; });
  if (entry == servers_.end()) return;
  servers_.erase(entry);
  ++generation_;
}

std::vector<ServerRegistry::Server> ServerRegistry::Servers(int64_t* generation) {
  const MutexLock lock(&mu_);
  ForgetIdle();
  std::vector<Server> servers;
  for (const auto& [address, entry] : servers_) {
    servers.push_back({entry.name, address, clock_->Now() - entry.last_word});
  }
  if (generation != nullptr) *generation = generation_;
  return servers;
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
