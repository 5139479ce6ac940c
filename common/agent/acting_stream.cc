#include "common/agent/acting_stream.h"

#include <map>

#include <c10/core/impl/VirtualGuardImpl.h>

#include "common/base/mutex.h"

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

}  // namespace craftfleet
