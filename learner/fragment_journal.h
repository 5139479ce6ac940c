// The fragments of the iteration under way, kept on disk: what a learner that is killed had taken in is not played
// again.

#ifndef CRAFTFLEET_LEARNER_FRAGMENT_JOURNAL_H_
#define CRAFTFLEET_LEARNER_FRAGMENT_JOURNAL_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/types.h"
#include "common/wire/convert.h"
#include "learner/run/append_file.h"
#include "learner/run/epoch.h"

namespace craftfleet {

// A file of records: size (4 bytes, little-endian), CRC-32C (likewise), bytes. The first has the run's id, the others a
// FragmentMessage each. Nothing is synced: it outlasts the process, and what a crash of the host leaves of it is
// checked. Thread-compatible: one thread at a time.
class FragmentJournal {
 public:
  // Touches nothing before the first Append or Clear, which creates `path` if it is not there. `fence` is asked before
  // each change, and outlives this; null: anyone may write.
  FragmentJournal(std::string path, std::string run_id, const EpochFence* fence = nullptr)
      : path_(std::move(path)), run_id_(std::move(run_id)), fence_(fence) {}

  // Fragments of this run in the order in which they were kept, up to the first record that is torn or does not fit: it
  // and what is behind it are cut off by the first Append.
  std::vector<Fragment> Read(const wire::FragmentShape& shape);

  // On failure nothing is kept any more until Clear, which gives room.
  //   ResourceExhausted: disk, quota or file size limit full.
  absl::Status Append(const Fragment& fragment);
  // Forgets all of them.
  absl::Status Clear();

 private:
  absl::Status Open();
  absl::Status AppendAll(const Fragment& fragment);
  absl::Status AppendRecord(absl::string_view bytes);

  const std::string path_;
  const std::string run_id_;
  const EpochFence* const fence_;
  std::optional<AppendFile> file_;  // none before the first change
  std::optional<int64_t> sound_;    // bytes, as Read found
  bool failed_ = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_FRAGMENT_JOURNAL_H_
