#include "learner/run/run_folder.h"

#include <algorithm>
#include <array>
#include <random>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/time.h>
#include <nlohmann/json.hpp>

#include "common/config.h"
#include "common/files.h"
#include "common/status_macros.h"
#include "learner/run/epoch.h"

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

std::string DescribeRun(const std::string& run_id, uint64_t seed, const ProgramInfo& program,
                        const std::string& origin) {
  nlohmann::ordered_json description = {{"run_id", run_id},
                                        {"program_version", program.version},
                                        {"git_revision", program.git_revision},
                                        {"seed", seed},
                                        {"texture_digest", program.texture_digest}};
  if (!origin.empty()) description["init_from"] = origin;
  return description.dump(2) + "\n";
}

// AlreadyExists if `logdir` has a run. One that ended before its first checkpoint (its port was in use, say) has
// nothing to go on with: its logs are removed.
absl::Status ClearUnbegunRun(const std::string& logdir) {
  if (!PathExists(JoinPath(logdir, kConfigFile))) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const CheckpointStore checkpoints,
                              CheckpointStore::Open(JoinPath(logdir, "checkpoints")));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, checkpoints.ListNewestFirst());
  if (!names.empty()) {
    return absl::AlreadyExistsError(
        absl::StrCat(logdir, " already has a run: go on with it by --resume, or use another --logdir"));
  }
  for (const char* file : kEpisodeFiles) CRAFTFLEET_RETURN_IF_ERROR(RemoveAll(JoinPath(logdir, file)));
  CRAFTFLEET_RETURN_IF_ERROR(RemoveAll(JoinPath(logdir, kEventsFile)));
  return RemoveAll(JoinPath(logdir, kConfigFile));
}

std::string BaseName(const std::string& path) { return path.substr(path.find_last_of('/') + 1); }

}  // namespace

RunFolder::RunFolder(std::string logdir, FolderLock lock, std::vector<EpisodeLog> episodes, EventLog events,
                     CheckpointStore checkpoints, ProgramInfo program)
    : logdir_(std::move(logdir)),
      lock_(std::move(lock)),
      program_(std::move(program)),
      episodes_(std::move(episodes)),
      events_(std::move(events)),
      checkpoints_(std::move(checkpoints)) {}

absl::StatusOr<std::unique_ptr<RunFolder>> RunFolder::Open(const std::string& logdir, FolderLock lock,
                                                           const ProgramInfo& program, Clock* clock) {
  std::vector<EpisodeLog> episodes;
  for (const char* name : kEpisodeFiles) {
    CRAFTFLEET_ASSIGN_OR_RETURN(AppendFile file, AppendFile::Open(JoinPath(logdir, name)));
    episodes.push_back({StatsLog(std::move(file)), {}});
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(EventLog events, EventLog::Open(JoinPath(logdir, kEventsFile), clock));
  CRAFTFLEET_ASSIGN_OR_RETURN(CheckpointStore checkpoints, CheckpointStore::Open(JoinPath(logdir, "checkpoints")));
  return std::unique_ptr<RunFolder>(
      new RunFolder(logdir, std::move(lock), std::move(episodes), std::move(events), std::move(checkpoints), program));
}

absl::StatusOr<std::unique_ptr<RunFolder>> RunFolder::Create(const std::string& logdir, const v1::RunConfig& config,
                                                             const ProgramInfo& program, Clock* clock,
                                                             const std::string& origin) {
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(logdir));
  CRAFTFLEET_ASSIGN_OR_RETURN(FolderLock lock, FolderLock::Acquire(logdir));
  CRAFTFLEET_RETURN_IF_ERROR(ClearUnbegunRun(logdir));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<RunFolder> folder, Open(logdir, std::move(lock), program, clock));
  folder->run_id_ = MakeRunId(clock->Now());
  folder->config_ = config;
  CRAFTFLEET_ASSIGN_OR_RETURN(folder->epoch_, NextEpoch(logdir));
  CRAFTFLEET_RETURN_IF_ERROR(
      ReplaceFile(JoinPath(logdir, "run.json"), DescribeRun(folder->run_id_, config.seed(), program, origin)));
  // Last, because it marks the folder as one with a run.
  CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(JoinPath(logdir, kConfigFile), FormatRunConfig(config)));
  return folder;
}

absl::StatusOr<ResumedRun> RunFolder::Resume(const std::string& logdir, const ResumeOptions& options,
                                             const ProgramInfo& program, Clock* clock) {
  if (!PathExists(JoinPath(logdir, kConfigFile))) {
    return absl::NotFoundError(absl::StrCat("no run to resume in ", logdir, ": it has no ", kConfigFile));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(FolderLock lock, FolderLock::Acquire(logdir));
  ResumedRun run;
  CRAFTFLEET_ASSIGN_OR_RETURN(run.folder, Open(logdir, std::move(lock), program, clock));
  const CheckpointStore& checkpoints = run.folder->checkpoints_;
  CRAFTFLEET_ASSIGN_OR_RETURN(run.checkpoint, options.from.empty() ? checkpoints.LoadLatest(options.agent)
                                                                   : checkpoints.Load(options.from, options.agent));
  CRAFTFLEET_RETURN_IF_ERROR(run.folder->CheckFits(run.checkpoint.state));
  CRAFTFLEET_RETURN_IF_ERROR(run.folder->GoBackTo(run.checkpoint.state));
  CRAFTFLEET_ASSIGN_OR_RETURN(run.folder->epoch_, NextEpoch(logdir));
  return run;
}

absl::Status RunFolder::TakeChanges(const v1::RunConfig& config) {
  config_.set_steps(config.steps());
  *config_.mutable_checkpoint() = config.checkpoint();
  return ReplaceFile(JoinPath(logdir_, kConfigFile), FormatRunConfig(config_));
}

void RunFolder::AddEpisodes(absl::Span<const Episode> episodes) { Log(EpisodeKind::kTraining).Add(episodes); }

void RunFolder::AddEvaluation(bool final, absl::Span<const Episode> argmax, absl::Span<const Episode> sampled) {
  Log(final ? EpisodeKind::kFinalArgmax : EpisodeKind::kArgmax).Add(argmax);
  Log(final ? EpisodeKind::kFinalSampled : EpisodeKind::kSampled).Add(sampled);
}

void RunFolder::EpisodeLog::Add(absl::Span<const Episode> episodes) {
  stats.Append(episodes);
  for (const Episode& episode : episodes) score.Add(episode);
}

absl::Status RunFolder::FlushLogs() {
  absl::Status status;
  for (AppendFile* log : Logs()) status.Update(log->Flush());
  return status;
}

int64_t RunFolder::waiting_bytes() const {
  int64_t bytes = events_.file().waiting_bytes();
  for (const EpisodeLog& log : episodes_) bytes += log.stats.file().waiting_bytes();
  return bytes;
}

absl::Status RunFolder::WriteCheckpoint(Checkpoint checkpoint) {
  if (score().episodes() > 0) best_score_ = std::max(best_score_, score().RecentReward());
  v1::CheckpointState& state = checkpoint.state;
  state.set_program_version(program_.version);
  state.set_run_id(run_id_);
  *state.mutable_config() = config_;
  state.set_texture_digest(program_.texture_digest);
  state.set_best_score(best_score_);
  state.clear_logs();
  CRAFTFLEET_RETURN_IF_ERROR(FlushLogs());
  for (AppendFile* log : Logs()) {
    // A checkpoint must not know of more than the logs have after a power cut.
    CRAFTFLEET_RETURN_IF_ERROR(log->Sync());
    v1::LogLength* length = state.add_logs();
    length->set_file(BaseName(log->path()));
    length->set_bytes(log->length());
  }
  return checkpoints_.Write(checkpoint);
}

std::vector<AppendFile*> RunFolder::Logs() {
  std::vector<AppendFile*> logs = {&events_.file()};
  for (EpisodeLog& log : episodes_) logs.push_back(&log.stats.file());
  return logs;
}

absl::Status RunFolder::CheckFits(const v1::CheckpointState& state) const {
  if (state.texture_digest() == program_.texture_digest) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("the run in ", logdir_, " was played with textures ",
                                                    state.texture_digest(), ", this program has ",
                                                    program_.texture_digest, ": give the run's by --textures"));
}

absl::Status RunFolder::GoBackTo(const v1::CheckpointState& state) {
  for (AppendFile* log : Logs()) {
    const auto length = std::find_if(state.logs().begin(), state.logs().end(),
                                     [&](const v1::LogLength& l) { return l.file() == BaseName(log->path()); });
    if (length == state.logs().end() && log->length() == 0) continue;  // an older program did not have it
    if (length == state.logs().end()) {
      return absl::DataLossError(absl::StrCat("the checkpoint does not know the length of ", log->path()));
    }
    CRAFTFLEET_RETURN_IF_ERROR(log->TruncateTo(length->bytes()));
  }
  CRAFTFLEET_RETURN_IF_ERROR(checkpoints_.DiscardNewerThan(state.iteration()));
  for (EpisodeLog& log : episodes_) {
    CRAFTFLEET_RETURN_IF_ERROR(
        VisitStats(log.stats.file().path(), [&log](const Episode& episode) { log.score.Add(episode); }));
  }
  run_id_ = state.run_id();
  config_ = state.config();
  best_score_ = state.best_score();
  return absl::OkStatus();
}

}  // namespace craftfleet
