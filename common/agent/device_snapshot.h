// A version of an agent's weights in a device's memory, and the streams on which policies and updates compute. Includes
// LibTorch's tensors and streams, but no header of CUDA.

#pragma once

#include <memory>
#include <optional>
#include <string>

#include <ATen/core/Tensor.h>
#include <absl/status/statusor.h>
#include <c10/core/Device.h>
#include <c10/core/Event.h>
#include <c10/core/Stream.h>

#include "common/agent/agent_spec.h"
#include "common/agent/nets/param_tensors.h"
#include "common/agent/policy_weights.h"
#include "common/base/mutex.h"

namespace craftfleet {

// The stream on which policies compute beside updates: one for each device and process, of high priority, since cuBLAS
// keeps memory for each stream that it has seen. Updates compute on the device's default stream. Thread-safe. Throws
// c10::Error.
c10::Stream ActingStream(at::Device device);

// The stream on which the calling thread computes on `device`.
c10::Stream CurrentStream(at::Device device);

// Policies on the same device look into it. Bytes are made when somebody first wants them, once for all. Thread-safe.
class DeviceSnapshot final : public PolicyWeights {
 public:
  // A copy of `weights`, float[n] on a device in the order of AlignedSpec. Throws c10::Error.
  DeviceSnapshot(AgentSpec spec, const at::Tensor& weights);

  // The first call waits for the device.
  absl::StatusOr<std::shared_ptr<const std::string>> Bytes() const override ABSL_LOCKS_EXCLUDED(mu_);

  // float[n], never to be written.
  const at::Tensor& flat() const { return flat_; }
  // Views of it.
  ParamTensors params() const;

  // Lets `stream` begin only when the weights are there, which another stream has copied. Throws c10::Error.
  void Await(const c10::Stream& stream) const;

 private:
  const AgentSpec spec_;
  const at::Tensor flat_;
  std::optional<c10::Event> copied_;  // unset on the CPU
  mutable Mutex mu_;
  mutable std::shared_ptr<const std::string> bytes_ ABSL_GUARDED_BY(mu_);  // null: nobody wanted them yet
};

}  // namespace craftfleet
