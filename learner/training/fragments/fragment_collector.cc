#include "learner/training/fragments/fragment_collector.h"

#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>

#include "common/base/status_macros.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kTick = absl::Milliseconds(200);
constexpr absl::Duration kReportEvery = absl::Seconds(15);

}  // namespace

absl::StatusOr<std::vector<Fragment>> FragmentCollector::Collect(size_t wanted, const OnTick& on_tick) {
  const auto is_complete = [&] { return collected_.size() >= wanted; };
  CRAFTFLEET_RETURN_IF_ERROR(CollectUntil(is_complete, wanted, on_tick));
  std::vector<Fragment> fragments;
  for (auto& [key, fragment] : collected_) fragments.push_back(std::move(fragment));
  collected_.clear();
  return fragments;
}

absl::StatusOr<std::vector<Fragment>> FragmentCollector::CollectRollout(size_t wanted, const OnTick& on_tick) {
  std::optional<std::vector<Arrival>> taken;
  const auto is_here = [this](const Arrival& arrival) {
    const auto found = collected_.find({arrival.permit.lane, arrival.permit.fragment});
    return found != collected_.end() && found->second.digest == arrival.digest;
  };
  // Fragments are accepted before they are queued, so the last ones may still be on their way.
  const auto is_complete = [&] {
    if (!taken.has_value()) taken = parts_.registry->lanes()->rollouts().TakeRollout();
    return taken.has_value() && std::all_of(taken->begin(), taken->end(), is_here);
  };
  CRAFTFLEET_RETURN_IF_ERROR(CollectUntil(is_complete, wanted, on_tick));
  std::map<Key, Fragment> rollout;
  for (const Arrival& arrival : *taken) {
    rollout.insert(collected_.extract({arrival.permit.lane, arrival.permit.fragment}));
  }
  std::vector<Fragment> fragments;
  for (auto& [key, fragment] : rollout) fragments.push_back(std::move(fragment));
  return fragments;
}

absl::Status FragmentCollector::CollectUntil(const std::function<bool()>& is_complete, size_t wanted,
                                             const OnTick& on_tick) {
  absl::Time last_news = parts_.clock->Now();
  int64_t resets = -1;  // the first pass drops what an update that was undone has left
  while (true) {
    // Fragments of lanes that were reset in the meantime are played again.
    if (resets != parts_.registry->lanes()->table().counters.resets) {
      resets = parts_.registry->lanes()->table().counters.resets;
      DropReset();
    }
    if (is_complete()) return absl::OkStatus();
    std::optional<Fragment> fragment = parts_.fragments->Pop(kTick);
    const bool is_idle = !fragment.has_value();
    if (!is_idle) {
      Add(*std::move(fragment));
      last_news = parts_.clock->Now();
    } else if (parts_.clock->Now() - last_news > kReportEvery) {
      last_news = parts_.clock->Now();
      const std::string played = parts_.registry->WaitsFor();
      LogInfo("waiting for actors: %d of %d fragments have arrived, actors joined: %d%s%s", collected_.size(), wanted,
              parts_.registry->lanes()->table().actors().size(), played.empty() ? "" : "; being played: ", played);
    }
    CRAFTFLEET_RETURN_IF_ERROR(on_tick(collected_.size(), is_idle));
  }
}

void FragmentCollector::Add(Fragment fragment) {
  if (!parts_.registry->lanes()->table().Counts(fragment.lane, fragment.number, fragment.digest)) return;
  const Key key = {fragment.lane, fragment.number};
  collected_[key] = std::move(fragment);
}

void FragmentCollector::DropReset() {
  for (auto entry = collected_.begin(); entry != collected_.end();) {
    const Fragment& fragment = entry->second;
    const bool counts = parts_.registry->lanes()->table().Counts(fragment.lane, fragment.number, fragment.digest);
    entry = counts ? std::next(entry) : collected_.erase(entry);
  }
}

}  // namespace craftfleet
