// Pictures of training for TensorBoard: what the agent sees, and where it looks.

#ifndef CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_PICTURES_H_
#define CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_PICTURES_H_

#include <memory>
#include <string>
#include <vector>

#include <absl/status/statusor.h>

#include "common/agent/agent_spec.h"
#include "common/base/types.h"
#include "learner/run/event_log.h"

namespace craftfleet {

inline constexpr int kIterationsPerPicture = 10;

// Of the last observation in `fragment`, enlarged four times: "rollout/frame" and, for agents with attention,
// "rollout/attention", the frame as bright as the agent's mean attention with `weights` (safetensors).
//   Errors as Policy::Create and Policy::Attention.
absl::StatusOr<std::vector<EventPicture>> TrainingPictures(const AgentSpec& spec,
                                                           std::shared_ptr<const std::string> weights,
                                                           const Fragment& fragment);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_PICTURES_H_
