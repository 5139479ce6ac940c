// Rank 0 of the learners that share out the updates of a run.

#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <absl/types/span.h>

#include "common/base/types.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ppo/value_norm.h"
#include "learner/ranks/rank_group.h"
#include "learner/ranks/rank_meeting.h"
#include "learner/training/distributed/rank_messages.h"

namespace craftfleet {

// Without other ranks, every call does nothing and succeeds. For one thread.
class RankLeader {
 public:
  // `canary` is this process's (PolicyCanary).
  RankLeader(RankOptions ranks, RankOffer offer, std::string canary)
      : ranks_(std::move(ranks)), offer_(std::move(offer)), canary_(std::move(canary)) {}

  // Waits for the other ranks, unless `should_stop` says otherwise, and gives them the run's state. From then on
  // `updater` shares its updates out.
  //   As RankMeeting, and lost().
  absl::Status Connect(std::function<bool()> should_stop, PpoUpdater* updater);

  // Gives the others what `updater` will learn from next: `scales` are of the values of each fragment.   As lost().
  absl::Status ShareUpdate(int64_t iteration, absl::Span<const ValueScale> scales,
                           absl::Span<const Fragment> fragments);

  // Tells the others to end, because the run is complete or was stopped.
  void End(bool is_complete);

  // OK while all ranks are there.
  //   Unavailable: one is lost; the message names it.   Others: as RankGroup.
  absl::Status lost() const;

 private:
  RankOptions ranks_;
  const RankOffer offer_;
  const std::string canary_;
  std::optional<RankGroup> group_;  // unset before Connect, and without other ranks
};

}  // namespace craftfleet
