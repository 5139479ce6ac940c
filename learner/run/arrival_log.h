// arrivals.jsonl: which fragments each update of an asynchronous run learned from, in the order of their arrival. A run
// is replayed from it. Format: FORMATS.md, section 11.

#ifndef CRAFTFLEET_LEARNER_RUN_ARRIVAL_LOG_H_
#define CRAFTFLEET_LEARNER_RUN_ARRIVAL_LOG_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/base/types.h"

namespace craftfleet {

inline constexpr char kArrivalsFile[] = "arrivals.jsonl";

// The fragments that one update learned from.
struct UpdateArrivals {
  int64_t policy_version = 0;      // from which the update started
  std::vector<Arrival> fragments;  // in the order of arrival
};

// Formats {"policy_version": 7, "fragments": [[lane, fragment, policy_version, "digest"], ...]} and a newline.
std::string FormatArrivals(const UpdateArrivals& update);

// Reads the record of a run, update by update. Not thread-safe.
class ArrivalReader {
 public:
  struct Run {
    int lanes = 1;
    int max_staleness = 1;
    int fragments = 1;  // of an update
  };
  // Reads the whole file `path`. A last line without its end, which a killed learner leaves, does not count.
  //   NotFound: no such file.
  static absl::StatusOr<ArrivalReader> Open(const std::string& path, const Run& run);

  bool at_end() const { return at_ == text_.size(); }
  // The next update; not at the end.
  //   DataLoss: the line is not as FORMATS.md says, or can't follow the one before; names path and line.
  absl::StatusOr<UpdateArrivals> Next();

 private:
  ArrivalReader(std::string path, std::string text, const Run& run);
  // Checks that the fragments continue their lanes, with versions that the update can learn from.
  absl::Status Check(const UpdateArrivals& update);

  std::string path_;
  std::string text_;
  Run run_;
  size_t at_ = 0;  // of the next line
  int64_t lines_ = 0;
  std::vector<int64_t> next_;  // fragment of each lane
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_ARRIVAL_LOG_H_
