#include "learner/training/distributed/rank_leader.h"

#include <memory>
#include <utility>

#include "common/base/status_macros.h"
#include "common/process/version.h"
#include "common/telemetry/log.h"

namespace craftfleet {

absl::Status RankLeader::Connect(std::function<bool()> should_stop, PpoUpdater* updater) {
  if (ranks_.world_size == 1) return absl::OkStatus();
  ranks_.should_stop = std::move(should_stop);
  LogInfo("waiting for the other ranks, %d (%s), at most %s, on %s", ranks_.world_size - 1, ranks_.given,
          absl::FormatDuration(ranks_.timeout), ranks_.address());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<RankMeeting> meeting,
                              RankMeeting::Open(ranks_, FormatRankOffer(offer_)));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<RankLinks> links, meeting->Connect({canary_, BuildId()}));
  group_.emplace(std::move(links));
  CRAFTFLEET_RETURN_IF_ERROR(ShareState(updater, &*group_));
  updater->ShareOut(&*group_);
  LogInfo("%d ranks share the updates out", ranks_.world_size);
  return absl::OkStatus();
}

absl::Status RankLeader::ShareUpdate(int64_t iteration, absl::Span<const ValueScale> scales,
                                     absl::Span<const Fragment> fragments) {
  return group_.has_value() ? SendUpdate(iteration, scales, fragments, &*group_) : absl::OkStatus();
}

void RankLeader::End(bool is_complete) {
  if (!group_.has_value()) return;
  const auto kind = is_complete ? RankCommand::Kind::kComplete : RankCommand::Kind::kStopped;
  const absl::Status sent = SendCommand(kind, &*group_);
  if (!sent.ok()) LogWarning("at the end of the run: %s", sent.message());
}

absl::Status RankLeader::lost() const { return group_.has_value() ? group_->ended() : absl::OkStatus(); }

}  // namespace craftfleet
