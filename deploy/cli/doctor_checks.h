// The checks of craftfleet doctor. They evaluate facts that doctor_command.cc has read and do not read anything
// themselves, so that tests can simulate any machine.

#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/telemetry/gpu_usage.h"
#include "common/wire/security.h"

namespace craftfleet {

enum class Verdict {
  kOk,
  kWarn,  // works, but slower or less safely than possible
  kFail,  // something will not work
};

// The result of a check.
struct Finding {
  std::string check;  // its name, "open files"
  Verdict verdict = Verdict::kOk;
  std::string found;   // one line
  std::string remedy;  // what to do; empty with kOk
};

// `description`: model and the instruction set that LibTorch uses; `avx2` and `avx512`: whether --cpu allows them;
// `threads`: CPUs that this process may use. kWarn without AVX2.
Finding CheckCpuFeatures(const std::string& description, bool avx2, bool avx512, int threads);

// `library`: file of the loaded BLAS, empty if unknown; `slow_warning`: SlowMathWarning(). kFail if there is one.
Finding CheckBlas(const std::string& library, const std::string& slow_warning);

// `available`: bytes of memory that this process can still use. kWarn below 2 GiB, kFail below 512 MiB.
Finding CheckMemory(int64_t available);

// `limit`: the hard limit of open files; programs raise their soft limit to it. kWarn below 4,096, kFail below 256.
Finding CheckOpenFiles(uint64_t limit);

// `folder`: the run's, or the nearest one above it that exists. kWarn below 2 GiB `free`, kFail below 256 MiB.
Finding CheckDiskSpace(const std::string& folder, const absl::StatusOr<int64_t>& free);

// `sync`: how long it takes to write 1 MiB and to sync it. kWarn from 0.1 s on; kFail from 5 s on and if the folder
// can't be written.
Finding CheckDiskSync(const std::string& folder, const absl::StatusOr<absl::Duration>& sync);

struct ClockFacts {
  absl::Time now;
  absl::Time program_built;          // modification time of the program's file
  std::optional<bool> synchronized;  // as the kernel reports; nullopt if it does not
};
// kFail if the clock is more than a day behind the program's file; kWarn if it is not synchronised.
Finding CheckClock(const ClockFacts& clock);

struct GpuFacts {
  std::vector<std::string> devices;  // what the driver says of each (DescribeGpu); without a driver "/dev/nvidia0"
  bool libtorch_has_cuda = false;    // the library libtorch_cuda is loaded
  int usable = 0;                    // GPUs that LibTorch sees
};
// "GPU 0: NVIDIA H100 80GB HBM3, 79.6 GiB, compute capability 9.0"; without what the driver does not say.
std::string DescribeGpu(int number, const GpuUsage& usage);

// kWarn for a GPU that this LibTorch can't use because it has no CUDA; kFail if it has CUDA but finds no GPU.
Finding CheckGpu(const GpuFacts& gpu);

// `bound`: the result of listening on `address` for a moment. kFail if that failed.
Finding CheckPort(const std::string& address, const absl::Status& bound);

// Reads the files, of which at least one is given. kFail: one can't be read, does not match the others, or the
// certificate is not valid now. kWarn: it expires within 30 days.
Finding CheckTls(const wire::TlsFiles& tls, absl::Time now);

}  // namespace craftfleet
