#include "learner/run/event_log.h"

#include <algorithm>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/crc32c.h"
#include "common/base/little_endian.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr char kFileVersion[] = "brain.Event:2";

void AppendMaskedCrc(absl::string_view bytes, std::string* out) {
  const uint32_t crc = Crc32c(bytes);
  AppendLittleEndian<uint32_t>(((crc >> 15) | (crc << 17)) + 0xA282EAD8U, out);
}

std::string Frame(absl::string_view data) {
  std::string frame;
  AppendLittleEndian<uint64_t>(data.size(), &frame);
  AppendMaskedCrc(std::string(frame), &frame);
  frame.append(data.data(), data.size());
  AppendMaskedCrc(data, &frame);
  return frame;
}

constexpr int kBuckets = 30;

// Fills buckets of equal width; a single one if all values are equal.
void FillHistogram(const std::vector<double>& values, v1::EventSummary::Histogram* histogram) {
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  const int buckets = *low < *high ? kBuckets : 1;
  const double width = (*high - *low) / buckets;
  std::vector<double> counts(buckets);
  for (const double value : values) {
    histogram->set_sum(histogram->sum() + value);
    histogram->set_sum_squares(histogram->sum_squares() + value * value);
    const int bucket = width > 0 ? static_cast<int>((value - *low) / width) : 0;
    ++counts[std::min(bucket, buckets - 1)];
  }
  histogram->set_min(*low);
  histogram->set_max(*high);
  histogram->set_num(static_cast<double>(values.size()));
  for (int i = 0; i < buckets; ++i) {
    histogram->add_bucket_limit(i == buckets - 1 ? *high : *low + (i + 1) * width);
    histogram->add_bucket(counts[i]);
  }
}

}  // namespace

absl::StatusOr<EventLog> EventLog::Open(const std::string& path, Clock* clock, const EpochFence* fence) {
  CRAFTFLEET_ASSIGN_OR_RETURN(AppendFile file, AppendFile::Open(path, fence));
  EventLog log(std::move(file), clock);
  if (log.file_.length() == 0) {
    v1::Event event;
    event.set_file_version(kFileVersion);
    log.Append(std::move(event));
    CRAFTFLEET_RETURN_IF_ERROR(log.file_.Flush());
  }
  return log;
}

void EventLog::AddScalars(int64_t step, absl::Span<const Scalar> scalars) {
  v1::Event event;
  event.set_step(step);
  for (const Scalar& scalar : scalars) {
    v1::EventSummary::Value* value = event.mutable_summary()->add_value();
    value->set_tag(scalar.tag);
    value->set_simple_value(static_cast<float>(scalar.value));
  }
  Append(std::move(event));
}

void EventLog::AddHistograms(int64_t step, absl::Span<const Histogram> histograms) {
  v1::Event event;
  event.set_step(step);
  for (const Histogram& histogram : histograms) {
    if (histogram.values.empty()) continue;
    v1::EventSummary::Value* value = event.mutable_summary()->add_value();
    value->set_tag(histogram.tag);
    FillHistogram(histogram.values, value->mutable_histo());
  }
  if (event.summary().value_size() > 0) Append(std::move(event));
}

void EventLog::Append(v1::Event event) {
  event.set_wall_time(absl::ToDoubleSeconds(clock_->WallNow() - absl::UnixEpoch()));
  file_.Append(Frame(event.SerializeAsString()));
}

}  // namespace craftfleet
