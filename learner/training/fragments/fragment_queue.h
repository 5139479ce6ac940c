// The accepted fragments on their way from the streams that receive them to the trainer.

#pragma once

#include "common/base/closable_queue.h"
#include "common/base/types.h"

namespace craftfleet {

// Bounded by the number of permits.
using FragmentQueue = ClosableQueue<Fragment>;

}  // namespace craftfleet
