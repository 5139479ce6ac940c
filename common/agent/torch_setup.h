// LibTorch's settings for this process and its threads, and warnings about the machine.

#pragma once

#include <string>

namespace craftfleet {

// One OpenMP and one BLAS thread, denormals flushed to zero, for the calling thread: each thread has its own settings.
// LibTorch's warnings go to the log, each text once in a process. Signals that stop the program do not interrupt it
// (stop_signals.h), unless it is the main thread, for which StopSignal does this. Policy and PpoUpdater call it
// themselves; cheap when repeated.
void SetUpTorchThread();

// A warning for the user if the networks would run much slower than possible; empty if there is none.
std::string SlowMathWarning();

// "Intel(R) Xeon(R) Processor, AVX512": workers whose descriptions differ may differ in the last bits of a policy's
// output.
std::string CpuDescription();

}  // namespace craftfleet
