// The folder of one run: what it is, its logs, its checkpoints, its score so far.
//   config.txt   the configuration as it ran        run.json   run id, versions, seed, texture digest
//   stats.jsonl  one line per training episode      events.out.tfevents.craftfleet   curves for TensorBoard
//   eval_argmax.jsonl, eval_sampled.jsonl           evaluation episodes during training, lines as in stats.jsonl
//   final_argmax.jsonl, final_sampled.jsonl         evaluation episodes after training
//   checkpoints/ iter-00000010 ...                  epoch, lock   see epoch.h, folder_lock.h

#ifndef CRAFTFLEET_LEARNER_RUN_RUN_FOLDER_H_
#define CRAFTFLEET_LEARNER_RUN_RUN_FOLDER_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/clock.h"
#include "common/types.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/run/checkpoint_store.h"
#include "learner/run/epoch.h"
#include "learner/run/event_log.h"
#include "learner/run/folder_lock.h"
#include "learner/run/score.h"
#include "learner/run/stats_log.h"

namespace craftfleet {

// The program that writes a run folder.
struct ProgramInfo {
  std::string version;         // "0.1.0"
  std::string git_revision;    // "39702b5"
  std::string texture_digest;  // of the textures in use
};

struct ResumeOptions {
  std::string from;   // a checkpoint's name ("iter-00000020"); empty: the newest
  std::string agent;  // refuse a run of another agent; empty: any
};

// Which of a run's episodes; each kind has a log of its own.
enum class EpisodeKind { kTraining, kArgmax, kSampled, kFinalArgmax, kFinalSampled };
inline constexpr int kNumEpisodeKinds = 5;

struct ResumedRun;

// Thread-compatible: one thread at a time. Locks the folder for its lifetime. Create and Resume only look; Begin
// changes the folder, once all else that a start needs has not failed, and comes before what adds and writes.
class RunFolder {
 public:
  // A new run in `logdir`, which is created if need be. `config` is complete (ResolveRunConfig); `clock` outlives
  // this. `origin`: where its weights come from, for run.json; empty: nowhere.
  // A run there that ended before its first checkpoint is replaced by Begin.
  //   AlreadyExists: the folder has a run.   FailedPrecondition: another process uses it.
  static absl::StatusOr<std::unique_ptr<RunFolder>> Create(const std::string& logdir, const v1::RunConfig& config,
                                                           const ProgramInfo& program, Clock* clock,
                                                           const std::string& origin = "");

  // Goes back to a checkpoint: counts the episodes of the logs as long as they were then. Begin removes later
  // checkpoints and cuts the logs.
  //   NotFound: no run there, or none with a checkpoint.   FailedPrecondition: in use, other textures, other agent.
  //   DataLoss: the checkpoint is torn, or a log is shorter than it was then.
  static absl::StatusOr<ResumedRun> Resume(const std::string& logdir, const ResumeOptions& options,
                                           const ProgramInfo& program, Clock* clock);

  const std::string& logdir() const { return logdir_; }
  const std::string& run_id() const { return run_id_; }  // "20240131-154500-a1b2c3", UTC
  const v1::RunConfig& config() const { return config_; }
  int64_t epoch() const { return epoch_; }  // of this start, from 1

  // Before Begin: takes over what may change when a run is resumed, its steps and how checkpoints are written and kept.
  void TakeChanges(const v1::RunConfig& config);

  // Makes this start the one that writes the folder; the logs are cut last. Called once.
  //   FailedPrecondition: another learner has begun meanwhile, which only happens where the disk's locks do not work.
  absl::Status Begin();

  // Whether this start is still the one that writes the folder; where it is not, nothing is written any more. Trouble
  // with reading that is no answer: OK.
  //   Aborted: a later start has taken over; names it.
  absl::Status CheckOwned() const;
  // For what else writes in the folder; allows nothing before Begin. Lives as long as this.
  const EpochFence* fence() const { return &fence_; }

  // Appends training episodes to stats.jsonl and counts them towards the score.
  void AddEpisodes(absl::Span<const Episode> episodes);
  // The same for an evaluation, during training or after it.
  void AddEvaluation(bool final, absl::Span<const Episode> argmax, absl::Span<const Episode> sampled);
  // Appends a point to each curve.
  void AddScalars(int64_t step, absl::Span<const Scalar> scalars) { events_->AddScalars(step, scalars); }

  // Writes what was added since the last time. What can't be written waits, to be written the next time.
  //   ResourceExhausted: disk, quota or file size limit full.
  absl::Status FlushLogs();
  int64_t waiting_bytes() const;  // of the logs, not written yet

  const ScoreBoard& score(EpisodeKind kind = EpisodeKind::kTraining) const {
    return scores_[static_cast<size_t>(kind)];
  }
  const CheckpointStore& checkpoints() const { return checkpoints_; }

  // Flushes and syncs the logs, then writes. Fills in everything of the state that the folder knows: program, run id,
  // configuration, texture digest, log lengths, best score. Errors as CheckpointStore::Write.
  absl::Status WriteCheckpoint(Checkpoint checkpoint);

 private:
  RunFolder(std::string logdir, FolderLock lock, ProgramInfo program, Clock* clock);
  absl::Status CheckFits(const v1::CheckpointState& state) const;
  // Of a checkpoint: checks that the logs have what it knows of, and counts their episodes.
  absl::Status CountLogs(const v1::CheckpointState& state);
  absl::Status RemoveUnbegunLogs() const;
  absl::Status OpenLogs();
  absl::Status DescribeNewRun() const;
  absl::Status GoBack();
  void Add(EpisodeKind kind, absl::Span<const Episode> episodes);
  std::vector<AppendFile*> Logs();

  const std::string logdir_;
  const FolderLock lock_;
  const ProgramInfo program_;
  Clock* const clock_;
  std::string origin_;  // of a new run
  std::string run_id_;
  v1::RunConfig config_;
  int64_t epoch_ = 0;
  std::optional<v1::CheckpointState> resumed_;  // iteration and lengths of logs only; none: a new run
  EpochFence fence_;
  std::array<ScoreBoard, kNumEpisodeKinds> scores_;
  std::vector<StatsLog> stats_;     // by kind; empty before Begin
  std::optional<EventLog> events_;  // none before Begin
  CheckpointStore checkpoints_;
  double best_score_ = -std::numeric_limits<double>::infinity();
};

struct ResumedRun {
  std::unique_ptr<RunFolder> folder;
  Checkpoint checkpoint;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_RUN_FOLDER_H_
