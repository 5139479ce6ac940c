#include "deploy/cli/sweep/sweep.h"

#include <algorithm>
#include <thread>
#include <utility>

#include <absl/strings/ascii.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>

#include "common/base/numbers.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "deploy/cli/sweep/run_identity.h"
#include "learner/run/folder_lock.h"
#include "learner/run/progress.h"

namespace craftfleet {
namespace {

std::string LogPath(const SweepJob& job) { return JoinPath(job.folder, "log.txt"); }

// The last line that is not empty; "" without any.
std::string LastLine(const std::string& path) {
  const absl::StatusOr<std::string> text = ReadFile(path);
  if (!text.ok()) return "";
  const std::vector<absl::string_view> lines = absl::StrSplit(*text, '\n', absl::SkipWhitespace());
  return lines.empty() ? "" : std::string(absl::StripAsciiWhitespace(lines.back()));
}

// FailedPrecondition: the folder has a run of another configuration.
absl::Status CheckConfiguration(const SweepJob& job) {
  const std::string path = JoinPath(job.folder, "config.txt");
  if (!PathExists(path)) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::RunConfig config, ParseRunConfig(text, path));
  CRAFTFLEET_ASSIGN_OR_RETURN(config, ResolveRunConfig(std::move(config)));
  config.set_steps(job.config.steps());  // may change when the run is resumed
  if (RunIdentity(config) == RunIdentity(job.config)) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(path, " is not this cell's configuration (", job.config_path, "): use another --logdir"));
}

}  // namespace

Sweep::Sweep(std::vector<SweepJob> jobs, const Options& options, std::ostream* out, Clock* clock)
    : jobs_(std::move(jobs)), options_(options), clock_(clock), out_(out), entries_(jobs_.size()) {}

absl::Status Sweep::Run() {
  LookAtFolders();
  start_ = clock_->Now();
  std::vector<std::thread> workers;
  const int count = std::min<int>(options_.jobs, static_cast<int>(jobs_.size()));
  {
    MutexLock lock(&mu_);
    working_ = count;
  }
  for (int i = 0; i < count; ++i) workers.emplace_back([this] { Work(); });
  ReportUntilOver();
  for (std::thread& worker : workers) worker.join();
  PrintLine(Progress());
  MutexLock lock(&mu_);
  const int failed = Count(Stage::kFailed);
  const int done = Count(Stage::kDone);
  if (failed > 0) return absl::InternalError(absl::StrFormat("%d of %d runs failed", failed, jobs_.size()));
  if (done == static_cast<int>(jobs_.size())) return absl::OkStatus();
  return absl::CancelledError(
      absl::StrFormat("stopped with %d of %d runs done; the same command resumes the sweep", done, jobs_.size()));
}

void Sweep::Stop() {
  MutexLock lock(&mu_);
  stopping_ = true;
  for (const Entry& entry : entries_) {
    if (entry.child != nullptr) entry.child->Terminate();
  }
  changed_.NotifyAll();
}

void Sweep::LookAtFolders() {
  int done = 0;
  for (size_t i = 0; i < jobs_.size(); ++i) {
    // Before any job starts, since the jobs of a cell share its file. Errors of a folder are reported when its job
    // starts.
    PrepareFolder(jobs_[i]).IgnoreError();
    const RunState state = ReadRunState(jobs_[i].folder, jobs_[i].config.steps()).value_or(RunState());
    MutexLock lock(&mu_);
    entries_[i].first_steps = std::min(state.steps, jobs_[i].config.steps());
    if (!state.finished) continue;
    entries_[i].stage = Stage::kDone;
    ++done;
  }
  PrintLine(absl::StrFormat("%s, of which %d are done already; %d at a time",
                            Counted(static_cast<int64_t>(jobs_.size()), "run"), done, options_.jobs));
}

void Sweep::Work() {
  for (;;) {
    size_t index = 0;
    {
      MutexLock lock(&mu_);
      while (next_ < jobs_.size() && entries_[next_].stage != Stage::kWaiting) ++next_;
      if (stopping_ || next_ == jobs_.size()) {
        --working_;
        changed_.NotifyAll();
        return;
      }
      index = next_++;
      entries_[index].stage = Stage::kRunning;
    }
    const absl::Status status = RunJob(index);
    if (status.ok()) {
      PrintLine(absl::StrCat("done: ", jobs_[index].name));
    } else if (!absl::IsCancelled(status)) {
      PrintLine(absl::StrCat("FAILED: ", jobs_[index].name, ": ", status.message()));
    }
    MutexLock lock(&mu_);
    entries_[index].stage = status.ok() ? Stage::kDone : absl::IsCancelled(status) ? Stage::kWaiting : Stage::kFailed;
    changed_.NotifyAll();
  }
}

absl::Status Sweep::RunJob(size_t index) {
  const SweepJob& job = jobs_[index];
  CRAFTFLEET_RETURN_IF_ERROR(PrepareFolder(job));
  for (;;) {
    CRAFTFLEET_RETURN_IF_ERROR(WaitUntilFree(job));
    CRAFTFLEET_RETURN_IF_ERROR(CheckConfiguration(job));
    CRAFTFLEET_ASSIGN_OR_RETURN(const RunState before, ReadRunState(job.folder, job.config.steps()));
    if (before.finished) return absl::OkStatus();
    const absl::Status status = RunChild(index, before);
    CRAFTFLEET_ASSIGN_OR_RETURN(const RunState after, ReadRunState(job.folder, job.config.steps()));
    if (after.finished) return absl::OkStatus();
    // The child failed because a process that was started earlier locked the folder only now.
    if (absl::IsInternal(status) && absl::IsFailedPrecondition(FolderLock::Acquire(job.folder).status())) continue;
    CRAFTFLEET_RETURN_IF_ERROR(status);
    MutexLock lock(&mu_);
    if (stopping_) return absl::CancelledError("stopping");
    return absl::InternalError(
        absl::StrFormat("it ended at %d of %d steps; see %s", after.steps, job.config.steps(), LogPath(job)));
  }
}

absl::Status Sweep::RunChild(size_t index, const RunState& before) {
  const SweepJob& job = jobs_[index];
  std::shared_ptr<ChildProcess> child;
  {
    // The lock is held during the start, so that either Stop() finds the child or this thread notices Stop().
    MutexLock lock(&mu_);
    if (stopping_) return absl::CancelledError("stopping");
    CRAFTFLEET_ASSIGN_OR_RETURN(
        child, ChildProcess::Start(options_.program, before.begun ? job.resume : job.start, LogPath(job)));
    entries_[index].child = child;
  }
  PrintLine(absl::StrCat(before.begun ? "resumes: " : "starts: ", job.name));
  const int exit_code = child->Wait();
  MutexLock lock(&mu_);
  entries_[index].child = nullptr;
  if (exit_code == 0) return absl::OkStatus();
  if (stopping_) return absl::CancelledError("stopping");
  return absl::InternalError(absl::StrFormat("exit code %d: %s (%s)", exit_code, LastLine(LogPath(job)), LogPath(job)));
}

absl::Status Sweep::WaitUntilFree(const SweepJob& job) {
  bool reported = false;
  for (;;) {
    {
      const absl::StatusOr<FolderLock> lock = FolderLock::Acquire(job.folder);
      if (!absl::IsFailedPrecondition(lock.status())) return lock.status();
      if (!std::exchange(reported, true)) PrintLine(absl::StrCat("waits: ", lock.status().message()));
    }
    MutexLock lock(&mu_);
    if (changed_.WaitFor(&mu_, options_.look_again,
                         [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_; })) {
      return absl::CancelledError("stopping");
    }
  }
}

void Sweep::ReportUntilOver() {
  for (;;) {
    {
      MutexLock lock(&mu_);
      const auto over = [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return working_ == 0; };
      if (changed_.WaitFor(&mu_, options_.report_every, over)) return;
    }
    PrintLine(Progress());
  }
}

std::string Sweep::Progress() {
  std::vector<Entry> entries;
  {
    MutexLock lock(&mu_);
    entries = entries_;
  }
  const auto count = [&entries](Stage stage) {
    return std::count_if(entries.begin(), entries.end(), [stage](const Entry& entry) { return entry.stage == stage; });
  };
  int64_t total = 0;
  int64_t reached = 0;
  int64_t gained = 0;
  for (size_t i = 0; i < jobs_.size(); ++i) {
    const int64_t wanted = jobs_[i].config.steps();
    int64_t steps = entries[i].first_steps;
    if (entries[i].stage == Stage::kDone) steps = wanted;
    if (entries[i].stage == Stage::kRunning) {
      steps = std::min(ReadRunState(jobs_[i].folder, wanted).value_or(RunState()).steps, wanted);
    }
    total += wanted;
    reached += steps;
    gained += steps - entries[i].first_steps;
  }
  const double seconds = absl::ToDoubleSeconds(clock_->Now() - start_);
  const double rate = seconds > 0 ? static_cast<double>(gained) / seconds : 0;
  const std::string left = rate > 0 ? FormatTimeLeft(static_cast<double>(total - reached) / rate) : "-";
  return absl::StrFormat("%d done, %d running, %d left, %d failed | %s/%s steps, %.0f/s, %s left", count(Stage::kDone),
                         count(Stage::kRunning), count(Stage::kWaiting), count(Stage::kFailed), WithCommas(reached),
                         WithCommas(total), rate, left);
}

void Sweep::PrintLine(absl::string_view line) {
  MutexLock lock(&out_mu_);
  *out_ << line << "\n" << std::flush;
}

int Sweep::Count(Stage stage) const {
  return static_cast<int>(
      std::count_if(entries_.begin(), entries_.end(), [stage](const Entry& entry) { return entry.stage == stage; }));
}

}  // namespace craftfleet
