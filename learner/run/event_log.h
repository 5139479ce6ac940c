// TensorBoard's event file: scalars and histograms over environment steps.
// Source: the TFRecord framing (length, masked CRC-32C of the length, data, masked CRC-32C of the data; little-endian)
// and event.proto, as TensorFlow documents them. Tags: FORMATS.md, section 6.

#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/clock.h"
#include "craftfleet/v1/event.pb.h"
#include "learner/run/append_file.h"
#include "learner/run/epoch.h"

namespace craftfleet {

struct Scalar {
  std::string tag;  // such as "rollout/reward"
  double value = 0;
};

// The distribution of `values`.
struct Histogram {
  std::string tag;
  std::vector<double> values;  // finite; without values nothing is written
};

inline constexpr int64_t kVersionRecordBytes = 40;  // with which the file begins

// Thread-compatible: one thread at a time.
class EventLog {
 public:
  // `clock`, the source of the events' wall time, outlives the log. If the file is empty, appends the version record.
  static absl::StatusOr<EventLog> Open(const std::string& path, Clock* clock, const EpochFence* fence = nullptr);

  // Appends one event with all `scalars` at environment step `step`; file().Flush() writes it.
  void AddScalars(int64_t step, absl::Span<const Scalar> scalars);
  // Likewise: histograms of 30 buckets of equal width from the smallest value to the largest.
  void AddHistograms(int64_t step, absl::Span<const Histogram> histograms);

  AppendFile& file() { return file_; }
  const AppendFile& file() const { return file_; }

 private:
  EventLog(AppendFile file, Clock* clock) : file_(std::move(file)), clock_(clock) {}
  void Append(v1::Event event);

  AppendFile file_;
  Clock* clock_;
};

}  // namespace craftfleet
