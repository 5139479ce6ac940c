#include "learner/run/epoch.h"

#include <random>
#include <vector>

#include <absl/strings/escaping.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>

#include "common/base/printable.h"
#include "common/base/range_check.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "learner/run/folder_lock.h"

namespace craftfleet {
namespace {

constexpr size_t kMostShown = 40;             // bytes of a damaged file
constexpr int64_t kMaxEpoch = kMaxCount - 1;  // the next start's number is sent to actors

std::string EpochPath(const std::string& logdir) { return JoinPath(logdir, "epoch"); }

// The file's content: the number, and the process that took it, unknown if somebody repaired the file.
struct EpochFile {
  int64_t epoch = 0;
  std::string by = "another learner";
};

absl::StatusOr<EpochFile> ParseEpoch(const std::string& path, const std::string& text) {
  const std::vector<std::string> lines = absl::StrSplit(text, '\n');
  EpochFile taken;
  if (!absl::SimpleAtoi(lines[0], &taken.epoch) || taken.epoch < 1 || taken.epoch > kMaxEpoch) {
    return absl::DataLossError(absl::StrCat(path, " begins with \"", Printable(lines[0].substr(0, kMostShown)),
                                            "\", want 1..", kMaxEpoch,
                                            ": write the number of starts of this run into it, or a larger one"));
  }
  if (lines.size() > 1 && !lines[1].empty()) taken.by = lines[1];
  return taken;
}

absl::StatusOr<EpochFile> ReadEpochFile(const std::string& logdir) {
  const absl::StatusOr<std::string> text = ReadFile(EpochPath(logdir));
  if (absl::IsNotFound(text.status())) return EpochFile();
  CRAFTFLEET_RETURN_IF_ERROR(text.status());
  return ParseEpoch(EpochPath(logdir), *text);
}

}  // namespace

absl::StatusOr<int64_t> ReadEpoch(const std::string& logdir) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const EpochFile taken, ReadEpochFile(logdir));
  return taken.epoch;
}

absl::Status EpochFence::Take(const std::string& logdir, int64_t epoch) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const EpochFile taken, ReadEpochFile(logdir));
  if (taken.epoch >= epoch) {
    return absl::FailedPreconditionError(absl::StrCat("run folder ", logdir, " was taken by ", taken.by,
                                                      " while this one started: use another --logdir"));
  }
  // The random part distinguishes two starts with the same number.
  std::random_device random;
  const std::string text = absl::StrFormat("%d\n%s, start %08x%08x\n", epoch, ProcessName(), random(), random());
  CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(EpochPath(logdir), text));
  logdir_ = logdir;
  text_ = text;
  epoch_ = epoch;
  return Check();
}

absl::Status EpochFence::Check() const {
  if (epoch_ == 0) return absl::FailedPreconditionError("this learner has not begun to write its run folder");
  const absl::StatusOr<std::string> text = ReadFile(EpochPath(logdir_));
  if (!text.ok()) {
    return absl::UnavailableError(
        absl::StrCat("cannot check whether this learner still owns its run folder: ", text.status().message()));
  }
  if (*text == text_) return absl::OkStatus();
  const absl::StatusOr<EpochFile> taken = ParseEpoch(EpochPath(logdir_), *text);
  if (!taken.ok()) {
    return absl::UnavailableError(
        absl::StrCat("cannot check whether this learner still owns its run folder: ", EpochPath(logdir_),
                     " is damaged: put back its two lines, \"", absl::CEscape(text_), "\""));
  }
  return absl::AbortedError(absl::StrCat(
      "run folder ", logdir_, " was taken over by ", taken->by, " (epoch ", taken->epoch, ", this one is epoch ",
      epoch_,
      "): the disk's locks have no effect; this learner writes nothing more. Start only one learner on a run folder"));
}

}  // namespace craftfleet
