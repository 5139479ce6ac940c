// A process status as text.

#pragma once

#include <string>

#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// `reply` as lines of printable ASCII. Other characters are replaced, because the text goes to a terminal and the
// process that sent the reply may not be trusted.
std::string StatusText(const v1::StatusReply& reply);

}  // namespace craftfleet
