// A status as text for people.

#ifndef CRAFTFLEET_DEPLOY_STATUS_TEXT_H_
#define CRAFTFLEET_DEPLOY_STATUS_TEXT_H_

#include <string>

#include <absl/strings/string_view.h>

#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// `text` in printable ASCII: it may come from a stranger, and goes to a terminal.
std::string PrintableText(absl::string_view text);

// What `reply` says, in lines of printable ASCII.
std::string StatusText(const v1::StatusReply& reply);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_STATUS_TEXT_H_
