// The folder of one run: what it is, its logs, its checkpoints, its score so far.
//   config.txt   the configuration as it ran        run.json   run id, versions, seed, texture digest
//   stats.jsonl  one line per training episode      events.out.tfevents.craftfleet   curves for TensorBoard
//   eval_argmax.jsonl, eval_sampled.jsonl           evaluation episodes during training, lines as in stats.jsonl
//   final_argmax.jsonl, final_sampled.jsonl         evaluation episodes after training
//   checkpoints/ iter-00000010 ...                  epoch, lock   see epoch.h, folder_lock.h

#ifndef CRAFTFLEET_LEARNER_RUN_RUN_FOLDER_H_
#define CRAFTFLEET_LEARNER_RUN_RUN_FOLDER_H_

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/clock.h"
#include "common/types.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/run/checkpoint_store.h"
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

// Thread-compatible: one thread at a time. Locks the folder for its lifetime.
class RunFolder {
 public:
  // Starts a run in `logdir`, which is created if need be. `config` is complete (ResolveRunConfig); `clock` outlives
  // this. `origin`: where its weights come from, for run.json; empty: nowhere.
  // A run there that ended before its first checkpoint is replaced.
  //   AlreadyExists: the folder has a run.   FailedPrecondition: another process uses it.
  static absl::StatusOr<std::unique_ptr<RunFolder>> Create(const std::string& logdir, const v1::RunConfig& config,
                                                           const ProgramInfo& program, Clock* clock,
                                                           const std::string& origin = "");

  // Goes back to a checkpoint: cuts the logs to the lengths it knows, counts their episodes again and removes later
  // checkpoints.
  //   NotFound: no run there, or none with a checkpoint.   FailedPrecondition: in use, other textures, other agent.
  //   DataLoss: the checkpoint is torn, or a log is shorter than it was then.
  static absl::StatusOr<ResumedRun> Resume(const std::string& logdir, const ResumeOptions& options,
                                           const ProgramInfo& program, Clock* clock);

  const std::string& logdir() const { return logdir_; }
  const std::string& run_id() const { return run_id_; }  // "20240131-154500-a1b2c3", UTC
  const v1::RunConfig& config() const { return config_; }
  int64_t epoch() const { return epoch_; }  // of this start, from 1

  // Takes over what may change when a run is resumed: its steps and how checkpoints are written and kept.
  absl::Status TakeChanges(const v1::RunConfig& config);

  // Appends training episodes to stats.jsonl and counts them towards the score.
  void AddEpisodes(absl::Span<const Episode> episodes);
  // The same for an evaluation, during training or after it.
  void AddEvaluation(bool final, absl::Span<const Episode> argmax, absl::Span<const Episode> sampled);
  // Appends a point to each curve.
  void AddScalars(int64_t step, absl::Span<const Scalar> scalars) { events_.AddScalars(step, scalars); }

  // Writes what was added since the last time. What can't be written waits, to be written the next time.
  //   ResourceExhausted: disk, quota or file size limit full.
  absl::Status FlushLogs();
  int64_t waiting_bytes() const;  // of the logs, not written yet

  const ScoreBoard& score(EpisodeKind kind = EpisodeKind::kTraining) const { return Log(kind).score; }
  const CheckpointStore& checkpoints() const { return checkpoints_; }

  // Flushes and syncs the logs, then writes. Fills in everything of the state that the folder knows: program, run id,
  // configuration, texture digest, log lengths, best score. Errors as CheckpointStore::Write.
  absl::Status WriteCheckpoint(Checkpoint checkpoint);

 private:
  struct EpisodeLog {
    StatsLog stats;
    ScoreBoard score;
    void Add(absl::Span<const Episode> episodes);
  };

  RunFolder(std::string logdir, FolderLock lock, std::vector<EpisodeLog> episodes, EventLog events,
            CheckpointStore checkpoints, ProgramInfo program);
  // Opened, not begun: Create and Resume fill in run id, configuration and epoch.
  static absl::StatusOr<std::unique_ptr<RunFolder>> Open(const std::string& logdir, FolderLock lock,
                                                         const ProgramInfo& program, Clock* clock);
  absl::Status CheckFits(const v1::CheckpointState& state) const;
  absl::Status GoBackTo(const v1::CheckpointState& state);
  std::vector<AppendFile*> Logs();
  EpisodeLog& Log(EpisodeKind kind) { return episodes_[static_cast<size_t>(kind)]; }
  const EpisodeLog& Log(EpisodeKind kind) const { return episodes_[static_cast<size_t>(kind)]; }

  const std::string logdir_;
  const FolderLock lock_;
  const ProgramInfo program_;
  std::string run_id_;
  v1::RunConfig config_;
  int64_t epoch_ = 0;
  std::vector<EpisodeLog> episodes_;  // by kind
  EventLog events_;
  CheckpointStore checkpoints_;
  double best_score_ = -std::numeric_limits<double>::infinity();
};

struct ResumedRun {
  std::unique_ptr<RunFolder> folder;
  Checkpoint checkpoint;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_RUN_FOLDER_H_
