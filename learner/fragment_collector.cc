#include "learner/fragment_collector.h"

#include <algorithm>
#include <optional>
#include <tuple>
#include <utility>

#include "common/telemetry/log.h"
#include "common/wire/fragment_digest.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kTick = absl::Milliseconds(200);
constexpr absl::Duration kReportEvery = absl::Seconds(15);

}  // namespace

void FragmentCollector::Begin(int64_t iteration, int64_t last_fragment, int64_t policy_version) {
  collected_.clear();
  TakeKept(iteration, last_fragment, policy_version);
  parts_.registry->OpenIteration(last_fragment, policy_version);
}

void FragmentCollector::BeginOpened() {
  collected_.clear();
  ClearJournal();
}

void FragmentCollector::TakeKept(int64_t iteration, int64_t last_fragment, int64_t policy_version) {
  for (Fragment& fragment : kept_) {
    if (fragment.policy_version != policy_version || fragment.number >= last_fragment) continue;
    const Permit permit = {fragment.lane, fragment.number, fragment.policy_version};
    fragment.digest = wire::FragmentDigest(fragment);
    fragment.sender = "an earlier start";
    if (parts_.registry->Restore(permit, fragment.snapshot, fragment.digest)) {
      collected_.push_back(std::move(fragment));
    }
  }
  kept_.clear();
  if (collected_.empty()) {
    ClearJournal();
  } else {
    LogInfo("%d fragments of iteration %d were restored from the journal", collected_.size(), iteration);
  }
}

absl::StatusOr<std::vector<Fragment>> FragmentCollector::Collect(size_t wanted, const OnTick& on_tick) {
  absl::Time last_news = parts_.clock->Now();
  int64_t resets = parts_.registry->resets();
  while (true) {
    // Fragments of lanes that were reset in the meantime are played again.
    if (resets != parts_.registry->resets()) {
      resets = parts_.registry->resets();
      DropReset();
    }
    if (collected_.size() >= wanted) break;
    std::optional<Fragment> fragment = parts_.fragments->Pop(kTick);
    const bool is_idle = !fragment.has_value();
    if (!is_idle) {
      Add(*std::move(fragment));
      last_news = parts_.clock->Now();
    } else if (parts_.clock->Now() - last_news > kReportEvery) {
      last_news = parts_.clock->Now();
      LogInfo("waiting for actors: %d of %d fragments have arrived, %d actors have joined", collected_.size(), wanted,
              parts_.registry->Actors().size());
    }
    if (absl::Status status = on_tick(collected_.size(), is_idle); !status.ok()) return status;
  }
  std::sort(collected_.begin(), collected_.end(), [](const Fragment& a, const Fragment& b) {
    return std::tie(a.lane, a.number) < std::tie(b.lane, b.number);
  });
  return std::move(collected_);
}

void FragmentCollector::Add(Fragment fragment) {
  if (!parts_.registry->Counts(fragment.lane, fragment.number, fragment.digest)) return;
  WriteJournal(fragment);
  const auto same = std::find_if(collected_.begin(), collected_.end(), [&](const Fragment& other) {
    return other.lane == fragment.lane && other.number == fragment.number;
  });
  if (same == collected_.end()) {
    collected_.push_back(std::move(fragment));
  } else {
    *same = std::move(fragment);
  }
}

void FragmentCollector::DropReset() {
  const auto counts = [this](const Fragment& fragment) {
    return parts_.registry->Counts(fragment.lane, fragment.number, fragment.digest);
  };
  const auto end = std::stable_partition(collected_.begin(), collected_.end(), counts);
  if (end == collected_.end()) return;
  collected_.erase(end, collected_.end());
  ClearJournal();
  for (const Fragment& fragment : collected_) WriteJournal(fragment);
}

void FragmentCollector::WriteJournal(const Fragment& fragment) {
  if (parts_.journal == nullptr) return;
  const absl::Status status = parts_.journal->Append(fragment);
  if (!status.ok()) LogError("%s; the rest of this iteration is not stored", status.message());
}

void FragmentCollector::ClearJournal() {
  if (parts_.journal == nullptr) return;
  if (const absl::Status status = parts_.journal->Clear(); !status.ok()) LogError("%s", status.message());
}

}  // namespace craftfleet
