// Ranges of what workers report and request; fragment_check.h has those of fragments.

#pragma once

#include <cstddef>
#include <cstdint>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/learner.pb.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet::wire {

// Largest error or reason text, bytes.
inline constexpr size_t kMaxReasonBytes = 300;
inline constexpr size_t kMaxGpuNameBytes = 96;

// All of these return InvalidArgument with the field, its value and what was expected.

absl::Status CheckCount(absl::string_view field, int64_t count, int64_t low, int64_t high);

// Checks that there are `wanted` of `unit`, such as bytes.
absl::Status CheckSize(absl::string_view field, int64_t size, int64_t wanted, absl::string_view unit);

// Checks the unique name of a worker: printable, not empty, at most kMaxTextBytes.
absl::Status CheckName(absl::string_view field, absl::string_view name);

absl::Status CheckJoin(const v1::JoinRequest& request);

// Checks a request in a run with `lanes` lanes.
absl::Status CheckPermitRequest(const v1::PermitRequest& request, int lanes);

// Checks that rates, counts and shares are within what a single process can reach.
absl::Status CheckSummary(const v1::ProcessSummary& summary);

// Checks what an actor reports about an environment server.
absl::Status CheckServerReport(const v1::Peer& server);

absl::Status CheckAnnouncement(const v1::Announcement& announcement);

}  // namespace craftfleet::wire
