// Log lines about an iteration whose update failed.

#ifndef CRAFTFLEET_LEARNER_TRAINING_UPDATE_FAILURE_H_
#define CRAFTFLEET_LEARNER_TRAINING_UPDATE_FAILURE_H_

#include <string>
#include <vector>

#include "common/base/types.h"

namespace craftfleet {

// One line for each sender of `fragments`, ordered by name, with its fragments and their extreme values. At most 16
// senders, and 300 bytes of fragment numbers each.
std::vector<std::string> DescribeSenders(const std::vector<Fragment>& fragments);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINING_UPDATE_FAILURE_H_
