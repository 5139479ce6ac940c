// What rank 0 tells the other learners of a run.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/types.h"
#include "common/wire/fragment_check.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ppo/value_norm.h"
#include "learner/ranks/rank_group.h"
#include "learner/training/fragments/fragment_frames.h"

namespace craftfleet {

// The run, as rank 0 offers it when the ranks meet.
struct RankOffer {
  v1::RunConfig config;  // complete
  std::string texture_digest;
};

std::string FormatRankOffer(const RankOffer& offer);
//   FailedPrecondition: it is from another version of CraftFleet.
absl::StatusOr<RankOffer> ParseRankOffer(absl::string_view text);

// Gives rank 0's weights and optimiser to all.
//   As RankGroup::Broadcast and PpoUpdater::Load.
absl::Status ShareState(PpoUpdater* updater, RankGroup* group);

// What the others do next.
struct RankCommand {
  enum class Kind : int64_t {
    kUpdate,    // learn from the iteration's fragments
    kComplete,  // the run is complete
    kStopped,   // rank 0 was stopped; it can be resumed
  };

  Kind kind = Kind::kStopped;
  int64_t iteration = 0;            // of kUpdate
  std::vector<ValueScale> scales;   // likewise: of each fragment's values
  std::vector<Fragment> fragments;  // likewise, in their order
};

// Sends or receives a command. Fragments that came as scene records travel so; the receiver draws them with `frames`.
//   As RankGroup::Broadcast; receiving also InvalidArgument: a fragment that is none of `shape`.
absl::Status SendCommand(RankCommand::Kind kind, RankGroup* group);
absl::Status SendUpdate(int64_t iteration, absl::Span<const ValueScale> scales, absl::Span<const Fragment> fragments,
                        RankGroup* group);
absl::StatusOr<RankCommand> ReceiveCommand(const wire::FragmentShape& shape, const FragmentFrames& frames,
                                           RankGroup* group);

}  // namespace craftfleet
