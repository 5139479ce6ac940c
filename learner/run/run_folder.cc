#include "learner/run/run_folder.h"

#include <algorithm>
#include <array>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/time.h>
#include <nlohmann/json.hpp>

#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "common/io/texture_digest.h"
#include "common/process/version.h"
#include "common/telemetry/log.h"
#include "learner/run/final_logs.h"
#include "learner/run/stats_log.h"

namespace craftfleet {
namespace {

constexpr char kConfigFile[] = "config.txt";
// By EpisodeKind.
constexpr std::array<const char*, kNumEpisodeKinds> kEpisodeFiles = {
    "stats.jsonl", "eval_argmax.jsonl", "eval_sampled.jsonl", "final_argmax.jsonl", "final_sampled.jsonl"};
// TensorBoard reads files with "tfevents" in their name.
constexpr char kEventsFile[] = "events.out.tfevents.craftfleet";

std::string MakeRunId(absl::Time now) {
  std::random_device random;
  return absl::StrFormat("%s-%06x", absl::FormatTime("%Y%m%d-%H%M%S", now, absl::UTCTimeZone()), random() & 0xFFFFFF);
}

std::string DescribeRun(const std::string& run_id, uint64_t seed, const std::string& texture_digest,
                        const std::string& origin) {
  nlohmann::ordered_json description = {{"run_id", run_id},
                                        {"program_version", std::string(ProgramVersion())},
                                        {"git_revision", std::string(GitRevision())},
                                        {"seed", seed},
                                        {"texture_digest", texture_digest}};
  if (!origin.empty()) description["init_from"] = origin;
  return description.dump(2) + "\n";
}

constexpr char kCheckpointFolder[] = "checkpoints";

absl::StatusOr<bool> HasCheckpoint(const std::string& logdir) {
  const CheckpointStore store = CheckpointStore::At(JoinPath(logdir, kCheckpointFolder));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, store.ListNewestFirst());
  return !names.empty();
}

// Bytes of the log; 0: there is none.
absl::StatusOr<int64_t> LogBytes(const std::string& path) {
  const absl::StatusOr<int64_t> size = FileSize(path);
  return absl::IsNotFound(size.status()) ? 0 : size;
}

// For a `logdir` without checkpoints. The first one precedes the first line of any log.
//   AlreadyExists: a log has lines, also compressed, so that the run has lost its checkpoints; or there are a run's
//   weights, as beside a collected result.
absl::Status CheckNotBegun(const std::string& logdir) {
  const auto check = [&logdir](const std::string& name, int64_t at_most) -> absl::Status {
    const std::string path = JoinPath(logdir, name);
    CRAFTFLEET_ASSIGN_OR_RETURN(const int64_t bytes, LogBytes(path));
    if (bytes <= at_most) return absl::OkStatus();
    return absl::AlreadyExistsError(absl::StrCat(path, " has ", bytes,
                                                 " bytes, but the run has no checkpoint: put its ", kCheckpointFolder,
                                                 " back and resume it with --resume, or use another --logdir"));
  };
  for (const char* name : kEpisodeFiles) {
    CRAFTFLEET_RETURN_IF_ERROR(check(name, 0));
    CRAFTFLEET_RETURN_IF_ERROR(check(absl::StrCat(name, ".gz"), 0));
  }
  if (PathExists(JoinPath(logdir, kConfigFile))) CRAFTFLEET_RETURN_IF_ERROR(check("weights.safetensors", 0));
  return check(kEventsFile, kVersionRecordBytes);
}

// AlreadyExists if `logdir` has a run, unless the run ended before its first checkpoint: nothing is lost then.
absl::Status CheckNoRun(const std::string& logdir) {
  const absl::StatusOr<bool> has_run = HasCheckpoint(logdir);
  if (!has_run.ok()) {
    return absl::AlreadyExistsError(absl::StrCat(logdir, " may have a run: ", has_run.status().message(),
                                                 "; resume it with --resume, or use another --logdir"));
  }
  if (!*has_run) return CheckNotBegun(logdir);
  if (!PathExists(JoinPath(logdir, kConfigFile))) {
    return absl::AlreadyExistsError(
        absl::StrCat(logdir, " already has a run, which lost its ", kConfigFile,
                     ": put back the configuration that it was started with, or use another --logdir"));
  }
  return absl::AlreadyExistsError(
      absl::StrCat(logdir, " already has a run: resume it with --resume, or use another --logdir"));
}

std::string BaseName(const std::string& path) { return path.substr(path.find_last_of('/') + 1); }

// The length of the log `name` in the checkpoint, in bytes; nothing: the checkpoint does not have it.
std::optional<int64_t> LengthOf(absl::string_view name, const v1::CheckpointState& state) {
  const auto length =
      std::find_if(state.logs().begin(), state.logs().end(), [&](const v1::LogLength& l) { return l.file() == name; });
  return length == state.logs().end() ? std::nullopt : std::make_optional(length->bytes());
}

}  // namespace

RunFolder::RunFolder(std::string logdir, FolderLock lock, std::string texture_digest, Clock* clock)
    : logdir_(std::move(logdir)),
      lock_(std::move(lock)),
      texture_digest_(std::move(texture_digest)),
      clock_(clock),
      checkpoints_(CheckpointStore::At(JoinPath(logdir_, kCheckpointFolder))) {}

absl::StatusOr<std::unique_ptr<RunFolder>> RunFolder::Create(const std::string& logdir, const v1::RunConfig& config,
                                                             const std::string& texture_digest, Clock* clock,
                                                             const std::string& origin) {
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(logdir));
  CRAFTFLEET_ASSIGN_OR_RETURN(FolderLock lock, FolderLock::Acquire(logdir));
  CRAFTFLEET_RETURN_IF_ERROR(CheckNoRun(logdir));
  std::unique_ptr<RunFolder> folder(new RunFolder(logdir, std::move(lock), texture_digest, clock));
  folder->origin_ = origin;
  folder->run_id_ = MakeRunId(clock->WallNow());
  folder->config_ = config;
  CRAFTFLEET_ASSIGN_OR_RETURN(const int64_t last_epoch, ReadEpoch(logdir));
  folder->epoch_ = last_epoch + 1;
  return folder;
}

absl::StatusOr<ResumedRun> RunFolder::Resume(const std::string& logdir, const std::string& from,
                                             const std::string& texture_digest, Clock* clock) {
  if (!PathExists(JoinPath(logdir, kConfigFile))) {
    return absl::NotFoundError(
        absl::StrCat("no run to resume in ", logdir, ": it has no ", kConfigFile, "; start it without --resume"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(FolderLock lock, FolderLock::Acquire(logdir));
  ResumedRun run;
  run.folder.reset(new RunFolder(logdir, std::move(lock), texture_digest, clock));
  RunFolder& folder = *run.folder;
  CRAFTFLEET_ASSIGN_OR_RETURN(const bool has_checkpoint, HasCheckpoint(logdir));
  if (!has_checkpoint) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckNotBegun(logdir));
    return absl::NotFoundError(absl::StrCat("no checkpoint in ", JoinPath(logdir, kCheckpointFolder), ": the run in ",
                                            logdir, " ended before its first one; start it again without --resume"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(run.checkpoint,
                              from.empty() ? folder.checkpoints_.LoadLatest() : folder.checkpoints_.Load(from));
  const v1::CheckpointState& state = run.checkpoint.state;
  folder.config_ = state.config();
  CRAFTFLEET_RETURN_IF_ERROR(folder.CheckFits(state));
  CRAFTFLEET_RETURN_IF_ERROR(folder.CountLogs(state));
  CRAFTFLEET_ASSIGN_OR_RETURN(const int64_t last_epoch, ReadEpoch(logdir));
  folder.epoch_ = last_epoch + 1;
  folder.run_id_ = state.run_id();
  folder.best_score_ = state.best_score();
  folder.resumed_ = state;
  folder.resumed_->clear_lanes();
  return run;
}

void RunFolder::TakeChanges(const v1::RunConfig& config) {
  config_.set_steps(config.steps());
  *config_.mutable_checkpoint() = config.checkpoint();
}

absl::Status RunFolder::Begin() {
  CRAFTFLEET_RETURN_IF_ERROR(fence_.Take(logdir_, epoch_));
  if (const absl::Status status = RemoveUnfinished(logdir_); !status.ok()) {
    LogWarning("%s; the next start on this folder tries again", status.message());
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoints_, CheckpointStore::Open(JoinPath(logdir_, kCheckpointFolder), &fence_));
  if (!resumed_.has_value()) CRAFTFLEET_RETURN_IF_ERROR(RemoveUnbegunLogs());
  // Checkpoints first, so that the logs of the newest one always exist.
  if (resumed_.has_value()) {
    CRAFTFLEET_RETURN_IF_ERROR(checkpoints_.DiscardNewerThan(resumed_->iteration()));
    CRAFTFLEET_RETURN_IF_ERROR(PrepareFinalLogs());
  }
  CRAFTFLEET_RETURN_IF_ERROR(OpenLogs());
  if (!resumed_.has_value()) {
    const std::string description = DescribeRun(run_id_, config_.seed(), texture_digest_, origin_);
    CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(JoinPath(logdir_, "run.json"), description));
  }
  // This file marks the folder as one with a run.
  CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(JoinPath(logdir_, kConfigFile), FormatRunConfig(config_)));
  return resumed_.has_value() ? CutLogs() : absl::OkStatus();
}

absl::Status RunFolder::PrepareFinalLogs() {
  CRAFTFLEET_RETURN_IF_ERROR(RestoreFinalLogs(logdir_, *resumed_));
  if (config_.steps() <= resumed_->env_steps()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(SetFinalLogsAside(logdir_, &*resumed_));
  for (const EpisodeKind kind : {EpisodeKind::kFinalArgmax, EpisodeKind::kFinalSampled}) {
    scores_[static_cast<size_t>(kind)] = ScoreBoard();
  }
  return absl::OkStatus();
}

absl::Status RunFolder::RemoveUnbegunLogs() const {
  for (const char* file : kEpisodeFiles) CRAFTFLEET_RETURN_IF_ERROR(RemoveAll(JoinPath(logdir_, file)));
  CRAFTFLEET_RETURN_IF_ERROR(RemoveAll(JoinPath(logdir_, kEventsFile)));
  return RemoveAll(JoinPath(logdir_, kConfigFile));
}

absl::Status RunFolder::OpenLogs() {
  for (const char* name : kEpisodeFiles) {
    CRAFTFLEET_ASSIGN_OR_RETURN(AppendFile file, AppendFile::Open(JoinPath(logdir_, name), &fence_));
    stats_.push_back(std::move(file));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(EventLog events, EventLog::Open(JoinPath(logdir_, kEventsFile), clock_, &fence_));
  events_.emplace(std::move(events));
  SyncFolder(JoinPath(logdir_, "..")).IgnoreError();  // which has a new folder's entry; it may not be readable
  return SyncFolder(logdir_);
}

absl::Status RunFolder::CheckOwned() const {
  const absl::Status status = fence_.Check();
  return absl::IsAborted(status) ? status : absl::OkStatus();
}

void RunFolder::Add(EpisodeKind kind, absl::Span<const Episode> episodes) {
  for (const Episode& episode : episodes) {
    stats_[static_cast<size_t>(kind)].Append(FormatStatsLine(episode));
    Count(kind, episode);
  }
}

void RunFolder::Count(EpisodeKind kind, const Episode& episode) {
  ScoreBoard& score = scores_[static_cast<size_t>(kind)];
  score.Add(episode);
  if (kind == EpisodeKind::kTraining) curve_.Add(episode.length, score);
}

void RunFolder::AddEvaluation(bool final, absl::Span<const Episode> argmax, absl::Span<const Episode> sampled) {
  Add(final ? EpisodeKind::kFinalArgmax : EpisodeKind::kArgmax, argmax);
  Add(final ? EpisodeKind::kFinalSampled : EpisodeKind::kSampled, sampled);
}

absl::Status RunFolder::FlushLogs() {
  absl::Status status;
  for (AppendFile* log : Logs()) status.Update(log->Flush());
  return status;
}

int64_t RunFolder::waiting_bytes() const {
  int64_t bytes = events_->file().waiting_bytes();
  for (const AppendFile& log : stats_) bytes += log.waiting_bytes();
  return bytes;
}

absl::Status RunFolder::WriteCheckpoint(Checkpoint checkpoint) {
  v1::CheckpointState& state = checkpoint.state;
  // The best must not depend on when a run was stopped or a checkpoint requested.
  const bool is_periodic = state.iteration() % config_.checkpoint().every_iterations() == 0;
  if (is_periodic && score().episodes() > 0) best_score_ = std::max(best_score_, score().RecentReward());
  state.set_program_version(std::string(ProgramVersion()));
  state.set_run_id(run_id_);
  *state.mutable_config() = config_;
  state.set_texture_digest(texture_digest_);
  state.set_best_score(best_score_);
  state.clear_logs();
  CRAFTFLEET_RETURN_IF_ERROR(FlushLogs());
  for (AppendFile* log : Logs()) {
    // After a power cut, the logs must not be shorter than the checkpoint states.
    CRAFTFLEET_RETURN_IF_ERROR(log->Sync());
    v1::LogLength* length = state.add_logs();
    length->set_file(BaseName(log->path()));
    length->set_bytes(log->length());
  }
  return checkpoints_.Write(checkpoint);
}

std::vector<AppendFile*> RunFolder::Logs() {
  std::vector<AppendFile*> logs = {&events_->file()};
  for (AppendFile& log : stats_) logs.push_back(&log);
  return logs;
}

absl::Status RunFolder::CheckFits(const v1::CheckpointState& state) const {
  return CheckTextureDigest(absl::StrCat("the run in ", logdir_), state.texture_digest(), texture_digest_);
}

absl::Status RunFolder::CountLogs(const v1::CheckpointState& state) {
  std::vector<std::string> names = {kEventsFile};
  names.insert(names.end(), kEpisodeFiles.begin(), kEpisodeFiles.end());
  for (const std::string& name : names) {
    const std::string path = FindFinalLog(logdir_, name, state);
    CRAFTFLEET_ASSIGN_OR_RETURN(const int64_t size, LogBytes(path));
    const std::optional<int64_t> length = LengthOf(name, state);
    if (!length.has_value()) {
      return absl::DataLossError(absl::StrCat("the checkpoint has no length for ", path));
    }
    if (*length > size) {
      return absl::DataLossError(absl::StrCat(path, " has ", size, " bytes, but the checkpoint expects ", *length,
                                              ": put back a whole copy of the file, or go back to an older checkpoint "
                                              "with --resume_from"));
    }
  }
  for (int kind = 0; kind < kNumEpisodeKinds; ++kind) {
    const int64_t length = LengthOf(kEpisodeFiles[kind], state).value_or(0);
    if (length == 0) continue;
    CRAFTFLEET_RETURN_IF_ERROR(
        VisitStats(FindFinalLog(logdir_, kEpisodeFiles[kind], state), length,
                   [&](const Episode& episode) { Count(static_cast<EpisodeKind>(kind), episode); }));
  }
  return absl::OkStatus();
}

absl::Status RunFolder::CutLogs() {
  for (AppendFile* log : Logs()) {
    const std::optional<int64_t> length = LengthOf(BaseName(log->path()), *resumed_);
    if (length.has_value()) CRAFTFLEET_RETURN_IF_ERROR(log->TruncateTo(*length));
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
