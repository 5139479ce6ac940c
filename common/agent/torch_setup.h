// LibTorch's settings for this process and its threads, and what is worth knowing about the machine under it.

#ifndef CRAFTFLEET_COMMON_AGENT_TORCH_SETUP_H_
#define CRAFTFLEET_COMMON_AGENT_TORCH_SETUP_H_

#include <string>

namespace craftfleet {

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
