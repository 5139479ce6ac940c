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
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/activity_meter.h"
#include "common/clock.h"
#include "common/mutex.h"
#include "common/types.h"
#include "craftfleet/v1/config.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/checkpoint_requests.h"
#include "learner/evaluation_schedule.h"
#include "learner/fragment_journal.h"
#include "learner/lane_ledger.h"
#include "learner/learner_service.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ppo/rollout.h"
#include "learner/run/progress.h"
#include "learner/run/run_folder.h"
#include "learner/weight_store.h"

namespace craftfleet {

// What the trainer has done. Written by the trainer, read by anyone.
struct TrainerCounters {
  std::atomic<int64_t> iteration{0};        // finished
  std::atomic<int64_t> env_steps{0};        // accepted, over all starts of the run
  std::atomic<int64_t> start_steps{0};      // of these, before this start
  std::atomic<int64_t> policy_version{-1};  // of the weights last published
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
    CheckpointRequests* checkpoints;
    FragmentJournal* journal;  // null: fragments are not kept
    Clock* clock;
  };

  // Begins after `state`, whose weights and optimiser are in the updater. `kept`: what the journal had.
  Trainer(const v1::RunConfig& config, const v1::CheckpointState& state, std::vector<Fragment> kept,
          const Parts& parts);

  // Trains until the configured steps are done, and evaluates then, or until Stop is called; both end with a checkpoint
  // of the last finished iteration.
  //   Errors that training can't outlive: of an update that fails twice in a row, or the last checkpoint can't be
  //   written. The last finished iteration has a checkpoint then.
  absl::Status Run();
  // Ends the run after the current minibatch; an unfinished iteration is dropped.
  void Stop();

  bool finished() const { return counters_.env_steps >= config_.steps(); }
  const TrainerCounters& counters() const { return counters_; }
  // Where its thread's time goes.
  const ActivityMeter& meter() const { return meter_; }
  void FillStatus(v1::StatusReply* reply) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // Cancelled: Stop was called.
  absl::Status RunIteration();
  // Those of `kept_` that belong to the iteration that begins and goes up to `last_fragment` (excluded) of each lane;
  // the ledger knows of them then.
  std::vector<Fragment> TakeKept(int64_t last_fragment);
  // What the iteration's fragments, in order, do to the weights. Unless OK, all is as before.
  absl::StatusOr<UpdateStats> Learn(int64_t iteration, const std::vector<Fragment>& fragments);
  // The update of `fragments` failed: they are dropped and will be played again. `error` if that happened in a row.
  absl::Status UndoIteration(const std::vector<Fragment>& fragments, const absl::Status& error);
  // Takes in one that still counts; it replaces one of the same number.
  void AddFragment(Fragment fragment, std::vector<Fragment>* fragments);
  // Drops those that the ledger has put back, here and in the journal.
  void DropPutBack(std::vector<Fragment>* fragments);
  // Keeps `fragment` in the journal, if there is one.
  void Keep(const Fragment& fragment);
  // Waits for what is missing in `fragments`; puts them in order.
  absl::Status Collect(std::vector<Fragment>* fragments);
  absl::Status FinishIteration(const std::vector<Fragment>& fragments, const UpdateStats& stats);
  // Makes the updater's weights those that are played and evaluated.
  void PublishWeights();
  void AddToLogs(const std::vector<Fragment>& fragments, const UpdateStats& stats);
  // Writes what the logs have to say. What a full disk does not take waits, to be written after a later iteration; with
  // kMaxWaitingBytes of it training waits for room.
  void FlushLogs() ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status WriteCheckpoint();
  // Writes one if somebody asked for it; between updates only.
  void ServeCheckpointRequests();
  // The same after the last iteration: tries again while the disk is full, until Stop.
  absl::Status WriteLastCheckpoint() ABSL_LOCKS_EXCLUDED(mu_);
  // Says `trouble` and returns after a second, or at once when Stop was called.
  void WaitForRoom(absl::string_view trouble) ABSL_LOCKS_EXCLUDED(mu_);
  void SayNowAndThen(absl::string_view trouble);
  // Takes the folder's score, and that of an iteration that took `seconds` (0: none has ended), for the status page.
  void Show(double seconds) ABSL_LOCKS_EXCLUDED(mu_);
  int fragments_per_lane() const;

  // What the status page shows, as of the last iteration.
  struct Shown {
    double iteration_seconds = 0;  // 0: none has ended since the start
    int64_t episodes = 0;
    double reward = 0;  // means of the last 100 episodes
    double length = 0;
    double score = 0;
    int unlocked = 0;
  };

  const v1::RunConfig config_;
  const Parts parts_;
  std::atomic<bool> stopping_{false};
  TrainerCounters counters_;
  ActivityMeter meter_;

  int failed_updates_ = 0;          // in a row
  std::atomic<int64_t> undone_{0};  // updates, since the start

  std::vector<Fragment> kept_;  // by an earlier start, until the first iteration begins

  // The run at the end of the last finished iteration: what a checkpoint holds.
  int64_t policy_version_;
  std::shared_ptr<const std::string> weights_;  // of that version, safetensors
  std::vector<LaneRecord> lanes_;
  int64_t checkpointed_ = -1;               // iteration of the last checkpoint
  bool checkpoint_missed_ = false;          // the last one could not be written
  absl::Time said_ = absl::InfinitePast();  // that the disk is full
  double train_seconds_;                    // before this start
  absl::Time start_;

  mutable Mutex mu_;
  CondVar stopped_;
  Shown shown_ ABSL_GUARDED_BY(mu_);
  absl::Time iteration_begin_ ABSL_GUARDED_BY(mu_) = absl::InfiniteFuture();  // of the one under way
  absl::Time checkpoint_time_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINER_H_
