// LibTorch's settings for this process and its threads, and what is worth knowing about the machine under it.

#ifndef CRAFTFLEET_COMMON_AGENT_TORCH_SETUP_H_
#define CRAFTFLEET_COMMON_AGENT_TORCH_SETUP_H_

#include <string>

namespace craftfleet {

// Raises malloc's thresholds, so that tensors reuse their memory instead of returning it to the system at every step
// (1.3 times as fast), and bounds malloc's arenas, so that memory does not grow with the threads that come and go.
// Once, at the start of a program that uses Policy or PpoUpdater.
void SetUpTorchProcess();

// One OpenMP and one BLAS thread, denormals flushed to zero, for the calling thread: each thread has its own settings.
// Policy and PpoUpdater call it themselves; cheap when repeated.
void SetUpTorchThread();

// What to tell the user if the networks would run much slower than they could; empty if nothing is wrong.
std::string SlowMathWarning();

// "Intel(R) Xeon(R) Processor, AVX512": workers whose descriptions differ may differ in the last bits of a policy's
// output.
std::string CpuDescription();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_TORCH_SETUP_H_
