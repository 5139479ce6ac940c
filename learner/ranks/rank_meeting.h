// How the learners of one run ("ranks") become a group.

#pragma once

#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "learner/ranks/rank_links.h"
#include "learner/ranks/rank_options.h"
#include "learner/ranks/rank_store.h"

namespace craftfleet {

// What all ranks must have in common.
struct RankBuild {
  std::string canary;  // PolicyCanary
  std::string build;   // for messages
  // Why this rank can't be part of what rank 0 offers. OK: it can.
  absl::Status objection = absl::OkStatus();
};

// Where the ranks meet before they are a group.
class RankMeeting {
 public:
  // Rank 0 listens and offers `offer` to the others, which connect and get it. Returns when this rank is there.
  //   Unavailable: rank 0 can't listen, or has not come in time; the message has address and port.
  //   InvalidArgument: they are no address.
  //   FailedPrecondition: this rank and rank 0 have different world sizes.
  //   Unimplemented: this build has no ranks.
  static absl::StatusOr<std::unique_ptr<RankMeeting>> Open(const RankOptions& options, const std::string& offer);
  RankMeeting(const RankMeeting&) = delete;
  RankMeeting& operator=(const RankMeeting&) = delete;

  // Rank 0's.
  const std::string& offer() const { return offer_; }

  // Waits for all ranks, compares their builds and connects them. To be called once.
  //   Unavailable: some have not come in time; names them to all that came.
  //   FailedPrecondition: a rank computes other numbers than rank 0, or objects; names it to all.
  //   AlreadyExists: another process has this rank.
  //   Cancelled: rank 0's should_stop said so.
  absl::StatusOr<std::unique_ptr<RankLinks>> Connect(const RankBuild& build);

 private:
  RankMeeting(const RankOptions& options, std::shared_ptr<RankStore> store, std::string offer);
  // Rank 0: waits for the others. What is wrong with them; OK: nothing.
  absl::Status CheckOthers(const RankBuild& build);
  // The others: tell rank 0 that they are here and what they are, and learn what it found.
  absl::Status Report(const RankBuild& build);
  // Rank 0: the store ends with this process, so it lets the others read the verdict first.
  void WaitUntilHeard();

  const RankOptions options_;
  const absl::Time deadline_;
  const std::shared_ptr<RankStore> store_;
  const std::string offer_;
};

}  // namespace craftfleet
