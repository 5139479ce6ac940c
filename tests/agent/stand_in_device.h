// A device for tests: LibTorch's "privateuseone", whose tensors are in host memory. As on a GPU, its computations
// refuse tensors of the CPU, and every copy to and from it is counted.

#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include <ATen/core/Tensor.h>
#include <ATen/core/ivalue.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

inline constexpr char kStandInDevice[] = "privateuseone:0";
inline constexpr int64_t kOtherStream = 7;  // the only one beside the default stream, 0

// What made the host and the device wait for each other.
struct DeviceTraffic {
  int64_t sent = 0;      // copies to the device
  int64_t fetched = 0;   // copies from the device
  int64_t read = 0;      // single numbers that the host asked for (at::Tensor::item)
  int64_t computed = 0;  // computations started on the device: what would be a GPU's kernels, one or several each
  int64_t awaited = 0;   // times that a stream was made to wait for another one
};

// Since the start of the process. Thread-safe.
DeviceTraffic TrafficSoFar();

// Lets the device run out of memory at call number `count` from now, 1 for the next one, with CUDA's words. Calls are
// computations, views and requests for memory.
// Thread-safe.
void RunOutOfMemoryAfter(int64_t count);

// Sees a computation, such as "aten::mm": its arguments, and the tensors that it returned.
using ComputationObserver = std::function<void(absl::string_view name, const std::vector<c10::IValue>& arguments,
                                               const std::vector<at::Tensor>& results)>;

// From now on `observer`, if not empty, is called after each computation, by one thread at a time.
// Thread-safe.
void ObserveComputations(ComputationObserver observer);

}  // namespace craftfleet
