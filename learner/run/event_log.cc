#include "learner/run/event_log.h"

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/crc32c.h"
#include "common/little_endian.h"
#include "common/status_macros.h"

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

}  // namespace

absl::StatusOr<EventLog> EventLog::Open(const std::string& path, Clock* clock, const AppendFile::Options& options) {
  CRAFTFLEET_ASSIGN_OR_RETURN(AppendFile file, AppendFile::Open(path, options));
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

void EventLog::Append(v1::Event event) {
  event.set_wall_time(absl::ToDoubleSeconds(clock_->WallNow() - absl::UnixEpoch()));
  file_.Append(Frame(event.SerializeAsString()));
}

}  // namespace craftfleet
