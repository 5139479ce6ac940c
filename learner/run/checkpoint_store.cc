#include "learner/run/checkpoint_store.h"

#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/strip.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kNamePrefix = "iter-";
constexpr absl::string_view kTemporaryPrefix = ".tmp-";
constexpr absl::string_view kReplacedPrefix = ".replaced-";

// Whether there is nothing of this name, not even a link that leads nowhere. False if the disk can't tell.
bool IsAbsent(const std::string& path) {
  struct stat found = {};
  return ::lstat(path.c_str(), &found) != 0 && (errno == ENOENT || errno == ENOTDIR);
}

// Includes checkpoints whose replacement was interrupted by a kill. Empty if there is no folder.
absl::StatusOr<std::vector<std::string>> ListCheckpoints(const std::string& folder) {
  if (IsAbsent(folder)) return std::vector<std::string>();
  absl::StatusOr<std::vector<std::string>> listed = ListFolder(folder);
  if (absl::IsNotFound(listed.status())) {
    return absl::UnavailableError(absl::StrCat(listed.status().message(), ": put back what this link leads to"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<std::string> names, std::move(listed));
  for (std::string& name : names) name = std::string(absl::StripPrefix(name, kReplacedPrefix));
  names.erase(std::remove_if(names.begin(), names.end(), [](const std::string& n) { return IterationOf(n) < 0; }),
              names.end());
  std::sort(names.begin(), names.end(),
            [](const std::string& a, const std::string& b) { return IterationOf(a) > IterationOf(b); });
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return names;
}

// The path of the checkpoint `name`; during a replacement, that of the old one until the new one is in place.
std::string PathIn(const std::string& folder, absl::string_view name) {
  const std::string replaced = JoinPath(folder, absl::StrCat(kReplacedPrefix, name));
  std::string path = JoinPath(folder, name);
  return !PathExists(path) && PathExists(replaced) ? replaced : path;
}

// Loads the checkpoint `name` of a store; errors as CheckpointStore::Load. One under a false name would be deleted by
// the run that resumes from it, with others.
absl::StatusOr<Checkpoint> LoadNamed(const std::string& folder, const std::string& name) {
  const std::string path = PathIn(folder, name);
  CRAFTFLEET_ASSIGN_OR_RETURN(Checkpoint checkpoint, LoadCheckpoint(path));
  const int64_t iteration = checkpoint.state.iteration();
  if (iteration == IterationOf(name)) return checkpoint;
  return absl::DataLossError(absl::StrCat("checkpoint ", path, " has the state after iteration ", iteration,
                                          ": rename it to ", CheckpointName(iteration), ", or move it elsewhere"));
}

// Deletes what no name of a checkpoint leads to any more. A file system may refuse, such as NFS (EBUSY) while another
// process has a file open: the next start of a learner tries again.
void Delete(const std::string& path) {
  if (const absl::Status status = RemoveAll(path); !status.ok()) {
    LogWarning("%s; the next start on this folder deletes it", status.message());
  }
}

// Completes or undoes a replacement that was interrupted by a kill.
absl::Status EndReplacement(const std::string& folder, const std::string& replaced) {
  const std::string name = replaced.substr(kReplacedPrefix.size());
  if (PathExists(JoinPath(folder, name))) {
    Delete(JoinPath(folder, replaced));
    return absl::OkStatus();
  }
  return RenameSynced(JoinPath(folder, replaced), JoinPath(folder, name));
}

// The newest checkpoint but the first of `newest_first` that can be loaded; "" if there is none.
std::string NewestOlder(const std::string& folder, const std::vector<std::string>& newest_first) {
  for (size_t i = 1; i < newest_first.size(); ++i) {
    if (LoadNamed(folder, newest_first[i]).ok()) return newest_first[i];
  }
  return "";
}

// Whether two checkpoints of the same iteration have the same evaluations, and so the same content.
bool SameEvaluations(const v1::CheckpointState& a, const v1::CheckpointState& b) {
  return a.pending_size() == b.pending_size() && a.final_evaluation_steps() == b.final_evaluation_steps();
}

}  // namespace

std::string CheckpointName(int64_t iteration) { return absl::StrFormat("%s%08d", kNamePrefix, iteration); }

int64_t IterationOf(absl::string_view name) {
  int64_t iteration = -1;
  if (!absl::ConsumePrefix(&name, kNamePrefix) || !absl::SimpleAtoi(name, &iteration)) return -1;
  return iteration;
}

absl::StatusOr<std::string> FindCheckpoint(const std::string& path) {
  if (PathExists(JoinPath(path, "MANIFEST"))) return path;
  for (const std::string& folder : {JoinPath(path, "checkpoints"), path}) {
    const absl::StatusOr<std::vector<std::string>> names = ListCheckpoints(folder);
    if (names.ok() && !names->empty()) return PathIn(folder, names->front());
    if (!names.ok() && folder != path) return names.status();
  }
  return absl::NotFoundError(
      absl::StrCat("no checkpoint at ", path, ": want a run's folder, or one like <logdir>/checkpoints/iter-00000010"));
}

absl::StatusOr<Checkpoint> LoadFound(const std::string& path, std::string* folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(*folder, FindCheckpoint(path));
  absl::StatusOr<Checkpoint> found = LoadCheckpoint(*folder);
  if (found.ok() || *folder == path) return found;
  const std::string parent = folder->substr(0, folder->rfind('/'));
  const std::string older = NewestOlder(parent, ListCheckpoints(parent).value_or(std::vector<std::string>()));
  if (older.empty()) return found;
  return absl::Status(found.status().code(), absl::StrCat(found.status().message(), "; the newest valid one is ",
                                                          PathIn(parent, older), ": give that one"));
}

absl::StatusOr<CheckpointStore> CheckpointStore::Open(const std::string& folder, const EpochFence* fence) {
  const CheckpointStore store(folder, fence);
  CRAFTFLEET_RETURN_IF_ERROR(store.CheckFence());
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFolder(folder));
  for (const std::string& name : names) {
    if (absl::StartsWith(name, kTemporaryPrefix)) Delete(JoinPath(folder, name));
    if (absl::StartsWith(name, kReplacedPrefix)) CRAFTFLEET_RETURN_IF_ERROR(EndReplacement(folder, name));
  }
  return store;
}

absl::Status CheckpointStore::Write(const Checkpoint& checkpoint) {
  const std::string name = CheckpointName(checkpoint.state.iteration());
  CRAFTFLEET_RETURN_IF_ERROR(CheckFence());
  if (PathExists(PathOf(name))) {
    const absl::StatusOr<Checkpoint> there = LoadNamed(folder_, name);
    if (there.ok() && SameEvaluations(there->state, checkpoint.state)) return absl::OkStatus();
  }
  const std::string temporary = TemporaryPath(name);
  absl::Status status = WriteCheckpointFiles(temporary, checkpoint);
  if (status.ok()) status = MoveIn(temporary, name);
  if (!status.ok()) {
    // Report the first error; the next Open removes what can't be removed now.
    RemoveAll(temporary).IgnoreError();
    return status;
  }
  return Prune(checkpoint.state.config().checkpoint().keep());
}

absl::Status CheckpointStore::MoveIn(const std::string& temporary, const std::string& name) {
  // Check again, since writing the files took a while.
  CRAFTFLEET_RETURN_IF_ERROR(CheckFence());
  const std::string path = PathOf(name);
  const std::string replaced = PathOf(absl::StrCat(kReplacedPrefix, name));
  const bool replaces = PathExists(path);
  absl::Status status = replaces ? RenameSynced(path, replaced) : absl::OkStatus();
  if (status.ok()) status = RenameSynced(temporary, path);
  if (status.ok()) {
    if (replaces) Delete(replaced);
    return status;
  }
  // If the sync of the rename failed, the name may vanish in a crash, so undo the rename.
  if (PathExists(path) && !PathExists(temporary)) RenameSynced(path, temporary).IgnoreError();
  if (PathExists(replaced)) RenameSynced(replaced, path).IgnoreError();
  return status;
}

absl::StatusOr<std::vector<std::string>> CheckpointStore::ListNewestFirst() const { return ListCheckpoints(folder_); }

absl::StatusOr<Checkpoint> CheckpointStore::Load(const std::string& name) const {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListNewestFirst());
  if (std::find(names.begin(), names.end(), name) == names.end()) {
    return absl::NotFoundError(absl::StrCat("no checkpoint ", name, " in ", folder_, ", which has ",
                                            names.empty() ? "none" : absl::StrJoin(names, ", ")));
  }
  return LoadNamed(folder_, name);
}

absl::StatusOr<Checkpoint> CheckpointStore::LoadLatest() const {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListNewestFirst());
  if (names.empty()) return absl::NotFoundError(absl::StrCat("no checkpoint in ", folder_));
  absl::StatusOr<Checkpoint> newest = LoadNamed(folder_, names.front());
  if (newest.ok()) return newest;
  const std::string older = NewestOlder(folder_, names);
  if (older.empty()) return newest;
  return absl::Status(newest.status().code(), absl::StrCat(newest.status().message(), "; the newest valid one is ",
                                                           older, ": resume from it with --resume_from=", older));
}

absl::Status CheckpointStore::DiscardNewerThan(int64_t iteration) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListNewestFirst());
  for (const std::string& name : names) {
    if (IterationOf(name) > iteration) CRAFTFLEET_RETURN_IF_ERROR(Remove(name));
  }
  return absl::OkStatus();
}

std::string CheckpointStore::PathOf(absl::string_view name) const { return JoinPath(folder_, name); }

std::string CheckpointStore::TemporaryPath(absl::string_view name) const {
  return PathOf(absl::StrCat(kTemporaryPrefix, fence_ != nullptr ? fence_->epoch() : 0, "-", name));
}

absl::Status CheckpointStore::Remove(const std::string& name) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckFence());
  // Rename first, so that a kill during the removal leaves no torn checkpoint under a valid name.
  const std::string discarded = TemporaryPath(absl::StrCat("old-", name));
  CRAFTFLEET_RETURN_IF_ERROR(RenameSynced(PathOf(name), discarded));
  Delete(discarded);
  return absl::OkStatus();
}

absl::Status CheckpointStore::Prune(size_t keep) {
  const absl::StatusOr<std::vector<std::string>> names = ListNewestFirst();
  if (!names.ok()) LogWarning("%s; the next checkpoint tries again", names.status().message());
  if (!names.ok() || names->size() <= keep) return absl::OkStatus();
  const std::string best = BestOf(*names);
  for (size_t i = keep; i < names->size(); ++i) {
    const std::string& name = (*names)[i];
    if (name == best) continue;
    const absl::Status removed = Remove(name);
    if (absl::IsAborted(removed)) return removed;  // the run has been taken over
    if (!removed.ok()) LogWarning("%s; the next checkpoint tries again", removed.message());
  }
  return absl::OkStatus();
}

std::string CheckpointStore::BestOf(const std::vector<std::string>& newest_first) const {
  std::string best;
  double best_score = 0;
  for (const std::string& name : newest_first) {
    const absl::StatusOr<v1::CheckpointState> state = LoadCheckpointState(PathOf(name));
    if (!state.ok()) continue;
    if (best.empty()) best_score = state->best_score();
    if (state->best_score() < best_score) break;
    best = name;
  }
  return std::isfinite(best_score) ? best : "";
}

}  // namespace craftfleet
