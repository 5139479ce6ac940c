// The stream on which policies compute beside updates. Includes LibTorch's streams, but no header of CUDA.

#pragma once

#include <c10/core/Device.h>
#include <c10/core/Stream.h>

namespace craftfleet {

// One for each device and process, of high priority: cuBLAS keeps memory for each stream that it has seen. Updates
// compute on the device's default stream. Thread-safe. Throws c10::Error.
c10::Stream ActingStream(at::Device device);

// The stream on which the calling thread computes on `device`.
c10::Stream CurrentStream(at::Device device);

}  // namespace craftfleet
