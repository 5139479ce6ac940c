// A learner that only computes gradients for rank 0 of its run.

#pragma once

#include <functional>
#include <memory>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/wire/fragment_check.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ranks/rank_group.h"
#include "learner/ranks/rank_meeting.h"
#include "learner/training/distributed/rank_messages.h"
#include "learner/training/fragments/fragment_frames.h"
#include "learner/training/stop_flag.h"

namespace craftfleet {

// Has neither run folder nor server: it gets configuration, weights and fragments from rank 0. Run is called once, from
// one thread; Stop is thread-safe.
class RankWorker {
 public:
  struct Options {
    RankOptions ranks;  // of a rank from 1 on
    int threads = 1;    // of the update, 1..256
    // What is wrong with rank 0's configuration for this process.
    std::function<absl::Status(const v1::RunConfig& config)> check;
  };

  // Meets the other ranks, and gets the state of the run.
  //   As RankMeeting; this rank's own objections included.
  static absl::StatusOr<std::unique_ptr<RankWorker>> Connect(const Options& options);

  // Computes until rank 0 ends.
  //   Unavailable: a rank is lost; the message names it.   Cancelled: Stop was called, and rank 0 went on.
  absl::Status Run();
  // Ends Run: at once if rank 0 ends as well, as it does where all ranks are asked to stop, or else within 3 s. Blocks
  // until then.
  void Stop();

 private:
  RankWorker(const RankOffer& offer, std::unique_ptr<PpoUpdater> updater, std::unique_ptr<RankLinks> links);
  // Learns from the fragments of `command`, as Trainer does on rank 0.
  absl::Status Update(const RankCommand& command);

  const wire::FragmentShape shape_;
  const FragmentFrames frames_;
  const std::unique_ptr<PpoUpdater> updater_;
  RankGroup group_;
  StopFlag ended_;  // Run
};

}  // namespace craftfleet
