#include "common/wire/request_check.h"

#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/wire/channel.h"
#include "common/wire/protocol.h"

namespace craftfleet::wire {
namespace {

// More than any process can reach: a step of Crafter takes microseconds, and a host has at most thousands of threads.
constexpr double kMaxStepsPerSecond = 1e9;
constexpr int kMaxGames = 1 << 20;
constexpr int kMaxThreads = 1 << 16;
constexpr int kMaxActivities = 16;
constexpr size_t kMaxActivityBytes = 32;
constexpr double kMaxStepMs = 3.6e6;  // an hour: the longest --env_timeout
constexpr double kMaxShare = 1.001;   // 1, with room for rounding

absl::Status CheckNumber(absl::string_view field, double number, double high) {
  if (number >= 0 && number <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s: %g, want 0..%g", field, number, high));
}

absl::Status CheckBytes(absl::string_view field, size_t size, size_t most) {
  if (size <= most) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s has %d bytes, want at most %d", field, size, most));
}

absl::Status CheckLane(absl::string_view field, int lane, int lanes) {
  if (lane >= 0 && lane < lanes) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s: lane %d, want 0..%d", field, lane, lanes - 1));
}

absl::Status CheckActive(const v1::PermitRequest& request, int lanes) {
  // Twice: while the verdict on a fragment is in transit, the actor may hold the next permit of the lane.
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("active permits", request.active_size(), 0, 2 * int64_t{lanes}));
  for (const v1::Permit& permit : request.active()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckLane("active", permit.lane(), lanes));
    CRAFTFLEET_RETURN_IF_ERROR(CheckCount("active.fragment", permit.fragment(), 0, kMaxCount));
    CRAFTFLEET_RETURN_IF_ERROR(CheckCount("active.policy_version", permit.policy_version(), 0, kMaxCount));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckCount(absl::string_view field, int64_t count, int64_t low, int64_t high) {
  if (count >= low && count <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s: %d, want %d..%d", field, count, low, high));
}

absl::Status CheckSize(absl::string_view field, int64_t size, int64_t wanted, absl::string_view unit) {
  if (size == wanted) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s: %d %s, want %d", field, size, unit, wanted));
}

absl::Status CheckName(absl::string_view field, absl::string_view name) {
  if (name.empty()) return absl::InvalidArgumentError(absl::StrFormat("%s is empty, want a unique name", field));
  return CheckText(field, name);
}

absl::Status CheckJoin(const v1::JoinRequest& request) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckName("actor", request.actor()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckText("address", request.address()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckText("cpu", request.cpu()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckText("build", request.build()));
  return CheckText("canary", request.canary());
}

absl::Status CheckPermitRequest(const v1::PermitRequest& request, int lanes) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckName("actor", request.actor()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("capacity", request.capacity(), 0, kMaxGames));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("wait_ms", request.wait_ms(), 0, 24 * 3600 * 1000));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("evaluation", request.evaluation(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("env_servers_generation", request.env_servers_generation(), 0, 4 * kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckActive(request, lanes));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("failures", request.failures_size(), 0, lanes));
  for (const v1::LaneFailure& failure : request.failures()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckLane("failures", failure.lane(), lanes));
    CRAFTFLEET_RETURN_IF_ERROR(CheckCount("failures.fragment", failure.fragment(), 0, kMaxCount));
    CRAFTFLEET_RETURN_IF_ERROR(CheckBytes("failures.reason", failure.reason().size(), kMaxReasonBytes));
  }
  return CheckSummary(request.summary());
}

absl::Status CheckSummary(const v1::ProcessSummary& summary) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckNumber("summary.steps_per_second", summary.steps_per_second(), kMaxStepsPerSecond));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("summary.lanes", summary.lanes(), 0, kMaxGames));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("summary.policy_version", summary.policy_version(), -1, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("summary.memory_bytes", summary.memory_bytes(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("summary.errors", summary.errors(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckBytes("summary.last_error", summary.last_error().size(), kMaxReasonBytes));
  CRAFTFLEET_RETURN_IF_ERROR(CheckBytes("summary.gpu", summary.gpu().size(), kMaxGpuNameBytes));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("summary.gpu_memory_bytes", summary.gpu_memory_bytes(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckCount("summary.gpu_memory_size_bytes", summary.gpu_memory_size_bytes(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckNumber("summary.gpu_utilization", summary.gpu_utilization(), 1));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("summary.threads", summary.threads(), 0, kMaxThreads));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("summary.times", summary.times_size(), 0, kMaxActivities));
  for (const v1::ActivityTime& time : summary.times()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckBytes("summary.times.activity", time.activity().size(), kMaxActivityBytes));
    CRAFTFLEET_RETURN_IF_ERROR(CheckNumber("summary.times.seconds", time.seconds(), static_cast<double>(kMaxCount)));
    CRAFTFLEET_RETURN_IF_ERROR(CheckNumber("summary.times.share", time.share(), kMaxShare));
  }
  return absl::OkStatus();
}

absl::Status CheckServerReport(const v1::Peer& server) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckText("address", server.address()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckNumber("step_ms", server.step_ms(), kMaxStepMs));
  return CheckSummary(server.summary());
}

absl::Status CheckAnnouncement(const v1::Announcement& announcement) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckName("name", announcement.name()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckText("address", announcement.address()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("advertise", announcement.address()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckText("build", announcement.build()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckText("canary", announcement.canary()));
  return CheckSummary(announcement.summary());
}

}  // namespace craftfleet::wire
