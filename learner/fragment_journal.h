// The fragments of the iteration under way, kept on disk: what a learner that is killed had taken in is not played
// again.

#ifndef CRAFTFLEET_LEARNER_FRAGMENT_JOURNAL_H_
#define CRAFTFLEET_LEARNER_FRAGMENT_JOURNAL_H_

#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/types.h"
#include "common/wire/convert.h"
#include "learner/run/append_file.h"

namespace craftfleet {

// A file of records: size (4 bytes, little-endian), CRC-32C (likewise), bytes. The first has the run's id, the others a
// FragmentMessage each. Nothing is synced: it outlasts the process, and what a crash of the host leaves of it is
// checked. Thread-compatible: one thread at a time.
class FragmentJournal {
 public:
  // Creates `path` if it is not there.
  static absl::StatusOr<FragmentJournal> Open(const std::string& path, const std::string& run_id);

  // Fragments of this run in the order in which they were kept, up to the first record that is torn or does not fit: it
  // and what is behind it are cut off.
  std::vector<Fragment> Read(const wire::FragmentShape& shape);

  // On failure nothing is kept any more until Clear, which gives room.
  //   ResourceExhausted: disk, quota or file size limit full.
  absl::Status Append(const Fragment& fragment);
  // Forgets all of them.
  absl::Status Clear();

 private:
  FragmentJournal(std::string run_id, AppendFile file) : run_id_(std::move(run_id)), file_(std::move(file)) {}
  absl::Status AppendRecord(absl::string_view bytes);

  const std::string run_id_;
  AppendFile file_;
  bool failed_ = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_FRAGMENT_JOURNAL_H_
