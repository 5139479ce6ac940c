// The accepted fragments on their way from the streams that receive them to the trainer.

#ifndef CRAFTFLEET_LEARNER_TRAINING_FRAGMENTS_FRAGMENT_QUEUE_H_
#define CRAFTFLEET_LEARNER_TRAINING_FRAGMENTS_FRAGMENT_QUEUE_H_

#include "common/base/closable_queue.h"
#include "common/base/types.h"

namespace craftfleet {

// Bounded by the number of permits.
using FragmentQueue = ClosableQueue<Fragment>;

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINING_FRAGMENTS_FRAGMENT_QUEUE_H_
