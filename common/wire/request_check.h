// Ranges of what workers say of themselves and ask for; fragment_check.h has those of what they played.

#ifndef CRAFTFLEET_COMMON_WIRE_REQUEST_CHECK_H_
#define CRAFTFLEET_COMMON_WIRE_REQUEST_CHECK_H_

#include <cstddef>
#include <cstdint>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/learner.pb.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet::wire {

// Texts for people: errors and reasons.
inline constexpr size_t kMaxReasonBytes = 300;

// All of these give InvalidArgument with field, value and what was expected.

// A name by which others know a worker: printable, not empty, of at most kMaxTextBytes.
absl::Status CheckName(absl::string_view field, absl::string_view name);

absl::Status CheckJoin(const v1::JoinRequest& request);

// Of a run with `lanes` lanes and fragments of `steps` steps.
absl::Status CheckPermitRequest(const v1::PermitRequest& request, int lanes, int steps);

// Rates, counts and shares of a process that does what one process can do.
absl::Status CheckSummary(const v1::ProcessSummary& summary);

absl::Status CheckAnnouncement(const v1::Announcement& announcement);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_REQUEST_CHECK_H_
