// The training loop: turns fragments into weights, logs and checkpoints.

#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "common/telemetry/activity_meter.h"
#include "craftfleet/v1/config.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ppo/value_norm.h"
#include "learner/run/checkpoint.h"
#include "learner/run/progress.h"
#include "learner/run/run_folder.h"
#include "learner/scheduling/worker_registry.h"
#include "learner/training/distributed/rank_leader.h"
#include "learner/training/evaluation_planner.h"
#include "learner/training/fragments/fragment_collector.h"
#include "learner/training/records/checkpoint_requests.h"
#include "learner/training/records/checkpoint_writer.h"
#include "learner/training/records/disk_wait.h"
#include "learner/training/records/training_log.h"
#include "learner/training/records/training_status.h"
#include "learner/training/stop_flag.h"
#include "learner/training/weight_store.h"

namespace craftfleet {

// The number of versions of the weights that may play at the same time.
int KeptVersions(const v1::RunConfig& config);

// An iteration opens permits, waits for every lane's fragments, orders them, computes advantages, runs the PPO epochs,
// publishes the weights and writes the logs. With config.overlap, it opens the permits of the next iteration before its
// update, with the weights of that moment, so that actors play during the update; these weights depend only on the
// iteration's number. The result does not depend on which actors play or in which order their fragments arrive.
//
// With config.max_staleness, permits never close, and an update takes the fragments that arrived first. Run is called
// from one thread; everything else is thread-safe.
class Trainer {
 public:
  struct Parts {
    RunFolder* folder;  // all pointers outlive the trainer
    PpoUpdater* updater;
    RankLeader* ranks;
    WorkerRegistry* registry;
    WeightStore* weights;
    FragmentQueue* fragments;
    EvaluationPlanner* evaluations;
    ProgressPrinter* progress;
    CheckpointRequests* checkpoints;
    Clock* clock;
    // Whether actors want the bytes of weights that a GPU has: they are then made before it begins the next update.
    bool sends_weights = false;
  };
  enum class Phase {
    kTraining,
    kEvaluating,  // training is over, the final evaluation is not
    kComplete,    // both are over
  };

  // Continues after `checkpoint`, whose weights and optimiser are already in the updater.
  Trainer(const v1::RunConfig& config, const Checkpoint& checkpoint, const Parts& parts);

  // Trains until the configured steps are done and then evaluates, unless Stop is called first. In all cases but that
  // of a GPU that failed, a checkpoint of the last finished iteration is written; phase() shows how far the run got.
  //   Errors: a GPU failed; the update failed twice in a row, after which a checkpoint of the last finished iteration
  //   is written; the last checkpoint can't be written; or another rank is lost (RankLeader::lost), after which a
  //   checkpoint is written likewise.
  absl::Status Run();
  // Ends Run after the current minibatch, or at once during the final evaluation. An unfinished iteration is dropped;
  // unfinished evaluations are stored in the checkpoint, and the next start continues them. Idempotent.
  void Stop();

  bool is_stopping() const { return stop_.is_set(); }
  Phase phase() const { return phase_; }
  // Whether the run is complete, with nothing left to resume.
  bool finished() const { return phase_ == Phase::kComplete; }
  const TrainerCounters& counters() const { return counters_; }
  // How the training thread's time is spent.
  const ActivityMeter& meter() const { return meter_; }
  const TrainingStatus& status() const { return status_; }
  void FillStatus(v1::StatusReply* reply) const { status_.Fill(meter_, checkpoints_.age(), reply); }

 private:
  bool is_asynchronous() const { return config_.max_staleness() > 0; }
  // Whether the run goes on after `iterations` more.
  bool has_steps_left(int iterations = 0) const {
    return counters_.env_steps + int64_t{iterations} * config_.ppo().rollout_steps() < config_.steps();
  }
  // The fragments of each lane up to the end of `iteration`, from 0.
  int64_t LastFragment(int64_t iteration) const;
  // Cancelled: Stop was called.   As RankLeader::lost.
  absl::Status CheckContinues() const;
  // What waits for evaluations call: serves requests for checkpoints, and returns whether the run is to end.
  std::function<bool()> OnWait();
  // Runs one iteration.   Cancelled: Stop was called.
  absl::Status RunIteration();
  // Opens the iteration's permits, unless they are open.
  void Begin();
  // Waits for the iteration's fragments.
  absl::StatusOr<std::vector<Fragment>> Collect();
  // Updates the weights with the iteration's fragments, which are in order. On an error nothing changes.
  absl::StatusOr<UpdateStats> Learn(const std::vector<Fragment>& fragments);
  // Drops `fragments`, whose update failed, so that they are played again. Returns `error` at the second failure in a
  // row.
  absl::Status UndoIteration(const std::vector<Fragment>& fragments, const absl::Status& error);
  // `lanes`: their records after `fragments`.
  absl::Status FinishIteration(const std::vector<Fragment>& fragments, const UpdateStats& stats,
                               std::vector<LaneRecord> lanes);
  // If `trained`, evaluates the final weights. Tells actors whether the run is complete.
  void End(bool trained);
  // Publishes weights for play and evaluation; `value_scale`: of the values that they predict.
  void Publish(int64_t version, std::shared_ptr<const PolicyWeights> weights, const ValueScale& value_scale);
  // Publishes the updater's weights as version `version`.
  void PublishWeights(int64_t version);
  // The run's state after its last finished iteration.
  absl::StatusOr<Checkpoint> MakeCheckpoint() const;
  double StepsPerSecond() const;

  const v1::RunConfig config_;
  const Parts parts_;
  StopFlag stop_;
  TrainerCounters counters_;
  std::atomic<Phase> phase_{Phase::kTraining};
  ActivityMeter meter_;
  TrainingStatus status_;
  DiskWait disk_;
  TrainingLog log_;
  CheckpointWriter checkpoints_;
  FragmentCollector collector_;

  int failed_updates_ = 0;  // in a row

  bool next_is_open_ = false;  // the permits of the iteration after the last finished one

  std::vector<LaneRecord> lanes_;  // as of the end of the last finished iteration

  const int64_t first_version_;  // of the weights at this start
  const double train_seconds_;   // before this start
  absl::Time start_;
};

}  // namespace craftfleet
