// The rollout of an iteration and the minibatches of all its epochs in a device's memory. Includes LibTorch's tensors.

#pragma once

#include <vector>

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include "common/agent/agent_spec.h"
#include "common/agent/nets/segments.h"
#include "learner/ppo/minibatches.h"
#include "learner/ppo/rollout.h"

namespace craftfleet {

// Uninitialised host memory; if `device` is a GPU, pinned, so that the GPU copies from and to it by itself. Throws
// c10::Error.
at::Tensor HostTensor(at::IntArrayRef shape, at::ScalarType type, at::Device device);

// n rows and after them one of zeros, the padding, whose weight is 1.
struct DeviceRollout {
  at::Tensor frames;      // uint8[n+1,H,W,3]
  at::Tensor actions;     // int64[n+1]
  at::Tensor log_probs;   // float[n+1], as Rollout has them
  at::Tensor advantages;  // float[n+1] not normalised
  at::Tensor returns;     // float[n+1]
  at::Tensor weights;     // float[n+1], as Rollout has them; undefined: 1
  at::Tensor states;      // float[k+1,state_size] the k states that the rollout has, then zeros; recurrent agents only
};

// The steps of one optimiser step.
struct DeviceMinibatch {
  at::Tensor rows;        // int64[m] of the DeviceRollout
  at::Tensor frame_rows;  // int64[m'] the same, then padding: recurrent agents' m varies, and a GPU plans anew for each
  Segments segments;      // without states; recurrent agents only
  at::Tensor first_states;  // int64[segments] of DeviceRollout::states, before each segment; likewise
};

// Sends `rollout` to `device`, from pinned memory if that is a GPU. Throws c10::Error.
DeviceRollout SendRollout(const Rollout& rollout, const AgentSpec& spec, at::Device device);

// Sends what CorrectLag may change: log-probabilities, advantages, returns and weights. Throws c10::Error.
void SendTargets(const Rollout& rollout, at::Device device, DeviceRollout* there);

// Sends `minibatches` of `rollout`, in one copy. Throws c10::Error.
std::vector<DeviceMinibatch> SendMinibatches(const std::vector<Minibatch>& minibatches, const Rollout& rollout,
                                             at::Device device);

}  // namespace craftfleet
