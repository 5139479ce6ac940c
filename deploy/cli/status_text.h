// A process status as text.

#ifndef CRAFTFLEET_DEPLOY_CLI_STATUS_TEXT_H_
#define CRAFTFLEET_DEPLOY_CLI_STATUS_TEXT_H_

#include <string>

#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// `reply` as lines of printable ASCII. Other characters are replaced, because the text goes to a terminal and the
// process that sent the reply may not be trusted.
std::string StatusText(const v1::StatusReply& reply);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_STATUS_TEXT_H_
