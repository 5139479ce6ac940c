// Stores the fragments of the current iteration on disk, so that a learner that was killed resumes with the fragments
// that it had accepted. File: learner/run/FORMATS.md, section 8.

#ifndef CRAFTFLEET_LEARNER_TRAINING_FRAGMENTS_FRAGMENT_JOURNAL_H_
#define CRAFTFLEET_LEARNER_TRAINING_FRAGMENTS_FRAGMENT_JOURNAL_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/base/types.h"
#include "common/wire/convert.h"
#include "learner/run/append_file.h"
#include "learner/run/epoch.h"

namespace craftfleet {

// A file of records. It is never synced: it survives a crash of the process, and after a crash of the host Read checks
// what is left. Thread-compatible: one thread at a time.
class FragmentJournal {
 public:
  // Changes nothing before the first Append or Clear, which creates `path` if it does not exist. `fence` is checked
  // before each change and outlives this; null: no check.
  FragmentJournal(std::string path, std::string run_id, const EpochFence* fence = nullptr)
      : path_(std::move(path)), run_id_(std::move(run_id)), fence_(fence) {}

  // Returns this run's fragments in the order of Append, up to the first record that is torn or does not match `shape`.
  // The first Append truncates the file there.
  std::vector<Fragment> Read(const wire::FragmentShape& shape);

  // Appends a fragment. After a failure, does nothing until Clear, which frees space.
  //   ResourceExhausted: disk, quota or file size limit full.
  absl::Status Append(const Fragment& fragment);
  // Removes all fragments.
  absl::Status Clear();

 private:
  absl::Status Open();
  absl::Status AppendAll(const Fragment& fragment);
  absl::Status AppendRecord(absl::string_view bytes);

  const std::string path_;
  const std::string run_id_;
  const EpochFence* const fence_;
  std::optional<AppendFile> file_;  // unset before the first change
  std::optional<int64_t> sound_;    // length of the valid part in bytes, found by Read
  bool failed_ = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINING_FRAGMENTS_FRAGMENT_JOURNAL_H_
