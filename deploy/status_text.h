// A status as text for people.

#ifndef CRAFTFLEET_DEPLOY_STATUS_TEXT_H_
#define CRAFTFLEET_DEPLOY_STATUS_TEXT_H_

#include <string>

#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// What `reply` says, in lines of printable ASCII: it may come from a stranger, and goes to a terminal.
std::string StatusText(const v1::StatusReply& reply);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_STATUS_TEXT_H_
