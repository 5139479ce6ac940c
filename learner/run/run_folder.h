// The folder of one run: its description, logs, checkpoints and current score. Every file, field by field:
// FORMATS.md.

#pragma once

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

#include "common/base/clock.h"
#include "common/base/types.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/run/append_file.h"
#include "learner/run/checkpoint_store.h"
#include "learner/run/epoch.h"
#include "learner/run/event_log.h"
#include "learner/run/folder_lock.h"
#include "learner/run/score.h"
#include "learner/run/score_curve.h"

namespace craftfleet {

// The kinds of episodes in a run; each has its own log.
enum class EpisodeKind { kTraining, kArgmax, kSampled, kFinalArgmax, kFinalSampled };
inline constexpr int kNumEpisodeKinds = 5;

struct ResumedRun;

// Locks the folder for its lifetime. Create and Resume only read the folder; Begin changes it. Begin is to be called
// once nothing else can fail in a start, and before any method that adds or writes. Thread-compatible: one thread at a
// time.
class RunFolder {
 public:
  // Prepares a new run in `logdir`, which is created if necessary. `config` is complete (CompleteConfig); `clock`
  // outlives this. `texture_digest`: of the textures in use. `origin`: the origin of its initial weights, for run.json;
  // empty: none. Begin replaces an existing run that ended before its first checkpoint.
  //   AlreadyExists: the folder has a run, or one that lost its checkpoints; or they cannot be listed.
  //   FailedPrecondition: another process uses it.
  static absl::StatusOr<std::unique_ptr<RunFolder>> Create(const std::string& logdir, const v1::RunConfig& config,
                                                           const std::string& texture_digest, Clock* clock,
                                                           const std::string& origin = "");

  // Prepares to resume from the checkpoint `from` ("iter-00000020"; empty: the newest), and counts the logged episodes
  // up to it. Begin removes later checkpoints and truncates the logs.
  //   NotFound: no run there, or one that ended before its first checkpoint.   AlreadyExists: the run lost its
  //   checkpoints.   FailedPrecondition: in use, other textures.
  //   DataLoss: the checkpoint is torn, or a log is shorter than the checkpoint states.
  static absl::StatusOr<ResumedRun> Resume(const std::string& logdir, const std::string& from,
                                           const std::string& texture_digest, Clock* clock);

  const std::string& logdir() const { return logdir_; }
  const std::string& run_id() const { return run_id_; }  // "20240131-154500-a1b2c3", UTC
  const v1::RunConfig& config() const { return config_; }
  int64_t epoch() const { return epoch_; }  // of this start, from 1

  // Adopts the fields of `config` that may change when a run is resumed: steps and checkpoint settings. To be called
  // before Begin.
  void TakeChanges(const v1::RunConfig& config);

  // Makes this start the folder's only writer; truncates the logs last. Called once.
  //   FailedPrecondition: another learner has begun in the meantime (only on disks whose locks have no effect).
  absl::Status Begin();

  // Checks whether this start still owns the folder; otherwise nothing more is written. Also OK if the file `epoch`
  // can't be read.
  //   Aborted: a later start has taken over; names it.
  absl::Status CheckOwned() const;

  // Appends training episodes to stats.jsonl and counts them towards the score.
  void AddEpisodes(absl::Span<const Episode> episodes) { Add(EpisodeKind::kTraining, episodes); }
  // The same for an evaluation, during training or after it.
  void AddEvaluation(bool final, absl::Span<const Episode> argmax, absl::Span<const Episode> sampled);
  // Appends a point to each curve.
  void AddScalars(int64_t step, absl::Span<const Scalar> scalars) { events_->AddScalars(step, scalars); }
  // Appends histograms for TensorBoard.
  void AddHistograms(int64_t step, absl::Span<const Histogram> histograms) { events_->AddHistograms(step, histograms); }

  // Writes all lines added so far. Lines that can't be written are kept for the next call.
  //   ResourceExhausted: disk, quota or file size limit reached.
  absl::Status FlushLogs();
  int64_t waiting_bytes() const;  // bytes of logs that are not written yet

  const ScoreBoard& score(EpisodeKind kind = EpisodeKind::kTraining) const {
    return scores_[static_cast<size_t>(kind)];
  }
  // Of training episodes.
  const ScoreCurve& curve() const { return curve_; }
  const CheckpointStore& checkpoints() const { return checkpoints_; }

  // Flushes and syncs the logs, then writes the checkpoint. Fills in the fields of its state that are known here:
  // program, run id, configuration, texture digest, log lengths, best score. Errors as CheckpointStore::Write.
  absl::Status WriteCheckpoint(Checkpoint checkpoint);

 private:
  RunFolder(std::string logdir, FolderLock lock, std::string texture_digest, Clock* clock);
  absl::Status CheckFits(const v1::CheckpointState& state) const;
  // Checks that the logs have the lengths in `state`, and counts their episodes.
  absl::Status CountLogs(const v1::CheckpointState& state);
  absl::Status RemoveUnbegunLogs() const;
  absl::Status OpenLogs();
  // Restores the checkpoint's logs of the final evaluation, or sets them aside if training continues.
  absl::Status PrepareFinalLogs();
  // Truncates the logs to their lengths in the checkpoint.
  absl::Status CutLogs();
  void Add(EpisodeKind kind, absl::Span<const Episode> episodes);
  void Count(EpisodeKind kind, const Episode& episode);
  std::vector<AppendFile*> Logs();

  const std::string logdir_;
  const FolderLock lock_;
  const std::string texture_digest_;
  Clock* const clock_;
  std::string origin_;  // of a new run
  std::string run_id_;
  v1::RunConfig config_;
  int64_t epoch_ = 0;
  std::optional<v1::CheckpointState> resumed_;  // without lanes; unset: a new run
  EpochFence fence_;
  std::array<ScoreBoard, kNumEpisodeKinds> scores_;
  ScoreCurve curve_;
  std::vector<AppendFile> stats_;   // by kind; empty before Begin
  std::optional<EventLog> events_;  // unset before Begin
  CheckpointStore checkpoints_;
  double best_score_ = -std::numeric_limits<double>::infinity();
};

struct ResumedRun {
  std::unique_ptr<RunFolder> folder;
  Checkpoint checkpoint;
};

}  // namespace craftfleet
