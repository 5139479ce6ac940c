#include "common/agent/device_snapshot.h"

#include <exception>
#include <map>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <c10/core/impl/VirtualGuardImpl.h>

#include "common/agent/aligned_weights.h"
#include "common/agent/device.h"
#include "common/agent/policy_net.h"
#include "common/agent/weights.h"

namespace craftfleet {

c10::Stream ActingStream(at::Device device) {
  static Mutex mu;
  static auto* const streams = new std::map<c10::DeviceIndex, c10::Stream>;
  const MutexLock lock(&mu);
  const auto known = streams->find(device.index());
  if (known != streams->end()) return known->second;
  const c10::impl::VirtualGuardImpl guard(device.type());
  const c10::Stream stream = guard.getStreamFromGlobalPool(device, /*isHighPriority=*/true);
  return streams->emplace(device.index(), stream).first->second;
}

c10::Stream CurrentStream(at::Device device) { return c10::impl::VirtualGuardImpl(device.type()).getStream(device); }

DeviceSnapshot::DeviceSnapshot(AgentSpec spec, const at::Tensor& weights)
    : spec_(std::move(spec)), flat_(weights.detach().clone()) {
  if (flat_.is_cpu()) return;
  copied_.emplace(flat_.device().type());
  copied_->record(CurrentStream(flat_.device()));
}

absl::StatusOr<std::shared_ptr<const std::string>> DeviceSnapshot::Bytes() const {
  const MutexLock lock(&mu_);
  if (bytes_ != nullptr) return bytes_;
  try {
    const at::Tensor fetched = flat_.cpu();
    std::vector<float> values(spec_.param_count);
    Unalign(spec_, fetched.data_ptr<float>(), &values);
    bytes_ = std::make_shared<const std::string>(SaveWeights(spec_, values));
  } catch (const std::exception& error) {
    return DeviceError("weights", error.what());
  }
  return bytes_;
}

void DeviceSnapshot::Await(const c10::Stream& stream) const {
  if (copied_.has_value()) copied_->block(stream);
}

ParamTensors DeviceSnapshot::params() const { return ParamsOf(AlignedSpec(spec_), flat_); }

}  // namespace craftfleet
