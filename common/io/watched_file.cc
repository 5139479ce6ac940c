#include "common/io/watched_file.h"

#include <sys/stat.h>

#include <thread>

#include <absl/status/statusor.h>

#include "common/base/mutex.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kCheckEvery = absl::Seconds(1);
constexpr absl::Duration kPatience = absl::Milliseconds(200);  // wait for a thread that is reading

}  // namespace

std::optional<std::string> WatchedFile::ReadIfChanged() {
  // The stamp is taken before reading: a change in between is found by the next call.
  struct stat status = {};
  Stamp stamp;
  if (stat(path_.c_str(), &status) == 0) {
    stamp = {status.st_ino, absl::ToUnixNanos(absl::TimeFromTimespec(status.st_mtim)), status.st_size};
    if (stamp == stamp_) {
      missing_ = false;
      return std::nullopt;
    }
  }
  absl::StatusOr<std::string> bytes = ReadFile(path_);
  if (!bytes.ok()) {
    if (!missing_) LogError("%s; its last content remains in effect until it is back", bytes.status().message());
    missing_ = true;
    return std::nullopt;
  }
  missing_ = false;
  stamp_ = stamp;
  return *std::move(bytes);
}

struct FileWatch::State {
  Mutex mu;
  CondVar changed;
  bool stopping ABSL_GUARDED_BY(mu) = false;
  bool ended ABSL_GUARDED_BY(mu) = false;

  // Whether the watch continues.
  bool Pause() ABSL_LOCKS_EXCLUDED(mu) {
    const MutexLock lock(&mu);
    changed.WaitFor(&mu, kCheckEvery, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) { return stopping; });
    return !stopping;
  }
};

FileWatch::FileWatch(const std::string& path, std::string contents, std::function<void(std::string)> changed)
    : state_(std::make_shared<State>()) {
  std::thread([state = state_, file = WatchedFile(path), before = std::move(contents),
               changed = std::move(changed)]() mutable {
    while (state->Pause()) {
      std::optional<std::string> now = file.ReadIfChanged();
      if (!now.has_value() || *now == before) continue;
      before = *now;
      changed(*std::move(now));
    }
    const MutexLock lock(&state->mu);
    state->ended = true;
    state->changed.NotifyAll();
  }).detach();
}

FileWatch::~FileWatch() {
  const MutexLock lock(&state_->mu);
  state_->stopping = true;
  state_->changed.NotifyAll();
  state_->changed.WaitFor(&state_->mu, kPatience,
                          [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(state_->mu) { return state_->ended; });
}

}  // namespace craftfleet
