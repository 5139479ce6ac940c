#include "actor/step_times.h"

#include <algorithm>
#include <cstddef>
#include <vector>

namespace craftfleet {

bool StepTimes::Add(const std::string& address, absl::Duration time, absl::Time now) {
  Server& server = servers_[address];
  server.begun = std::min(server.begun, now - time);
  server.total += time;
  ++server.steps;
  if (now - server.begun < kWindow) return false;
  server.typical = server.total / server.steps;
  server.best = std::min(server.best, *server.typical);
  server.begun = absl::InfiniteFuture();
  server.total = absl::ZeroDuration();
  server.steps = 0;
  return true;
}

std::optional<absl::Duration> StepTimes::TypicalOf(const std::string& server) const {
  const auto found = servers_.find(server);
  return found == servers_.end() ? std::nullopt : found->second.typical;
}

std::optional<absl::Duration> StepTimes::OthersOf(const std::string& server) const {
  std::vector<absl::Duration> others;
  for (const auto& [address, other] : servers_) {
    if (address != server && other.typical.has_value()) others.push_back(*other.typical);
  }
  if (others.empty()) return std::nullopt;
  const auto middle = others.begin() + static_cast<std::ptrdiff_t>((others.size() - 1) / 2);
  std::nth_element(others.begin(), middle, others.end());
  return *middle;
}

bool StepTimes::IsSlowerThanOthers(const std::string& server, absl::Duration typical) const {
  const std::optional<absl::Duration> others = OthersOf(server);
  return others.has_value() && typical >= kNeverSlow && typical >= kSeveral * *others;
}

bool StepTimes::IsSlow(const std::string& server, absl::Duration typical) const {
  const auto known = servers_.find(server);
  const bool was_faster = known != servers_.end() && typical >= kSeveral * known->second.best;
  return IsSlowerThanOthers(server, typical) || typical >= kAlwaysSlow || (was_faster && typical >= kSlowerThanBefore);
}

void StepTimes::Reset(const std::string& address) {
  const auto found = servers_.find(address);
  if (found == servers_.end()) return;
  const absl::Duration best = found->second.best;
  found->second = {};
  found->second.best = best;
}

}  // namespace craftfleet
