// The training loop: fragments in, weights, logs and checkpoints out.

#ifndef CRAFTFLEET_LEARNER_TRAINER_H_
#define CRAFTFLEET_LEARNER_TRAINER_H_

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/clock.h"
#include "common/types.h"
#include "craftfleet/v1/config.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/evaluation_schedule.h"
#include "learner/lane_ledger.h"
#include "learner/learner_service.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ppo/rollout.h"
#include "learner/run/progress.h"
#include "learner/run/run_folder.h"
#include "learner/weight_store.h"

namespace craftfleet {

// What the trainer has done and where its time went. Written by the trainer, read by anyone.
struct TrainerCounters {
  std::atomic<int64_t> iteration{0};    // finished
  std::atomic<int64_t> env_steps{0};    // accepted, over all starts of the run
  std::atomic<int64_t> start_steps{0};  // of these, before this start
  std::atomic<int64_t> collect_ns{0};   // waiting for fragments
  std::atomic<int64_t> update_ns{0};    // PPO
  std::atomic<int64_t> other_ns{0};     // advantages, logs, checkpoints, publishing
};

// One iteration: open permits, wait for every lane's fragments, order them, advantages, PPO epochs, publish the
// weights, write logs. A run is the same whoever plays: nothing here depends on the order in which fragments arrive.
// Run is called from one thread; Stop, counters and FillStatus from any.
class Trainer {
 public:
  struct Parts {
    RunFolder* folder;  // all of them outlive the trainer
    PpoUpdater* updater;
    LaneLedger* ledger;
    WeightStore* weights;
    FragmentQueue* fragments;
    EvaluationSchedule* evaluations;
    ProgressPrinter* progress;
    Clock* clock;
  };

  // Begins after `state`, whose weights and optimiser are in the updater.
  Trainer(const v1::RunConfig& config, const v1::CheckpointState& state, const Parts& parts);

  // Trains until the configured steps are done, and evaluates then, or until Stop is called; both end with a checkpoint
  // of the last finished iteration.
  //   Errors that training can't outlive: of the update, or the last checkpoint can't be written.
  absl::Status Run();
  // Ends the run after the current minibatch; an unfinished iteration is dropped.
  void Stop();

  bool finished() const { return counters_.env_steps >= config_.steps(); }
  const TrainerCounters& counters() const { return counters_; }
  void FillStatus(v1::StatusReply* reply) const;

 private:
  // Cancelled: Stop was called.
  absl::Status RunIteration();
  absl::StatusOr<std::vector<Fragment>> Collect();
  absl::Status FinishIteration(const std::vector<Fragment>& fragments, const UpdateStats& stats);
  // Makes the updater's weights those that are played and evaluated.
  void PublishWeights();
  void WriteLogs(const UpdateStats& stats);
  absl::Status WriteCheckpoint();
  int fragments_per_lane() const;

  const v1::RunConfig config_;
  const Parts parts_;
  std::atomic<bool> stopping_{false};
  TrainerCounters counters_;

  // The run at the end of the last finished iteration: what a checkpoint holds.
  int64_t policy_version_;
  std::shared_ptr<const std::string> weights_;  // of that version, safetensors
  std::vector<LaneRecord> lanes_;
  std::vector<Episode> unlogged_;  // episodes that could not be written yet
  int64_t checkpointed_ = -1;      // iteration of the last checkpoint
  double train_seconds_;           // before this start
  absl::Time start_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINER_H_
