// GPUs as NVIDIA's driver reports them (NVML, loaded if it is there).

#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

namespace craftfleet {

// Of the whole GPU, other processes included.
struct GpuUsage {
  std::string name;                // "NVIDIA H100 80GB HBM3"
  int64_t memory_bytes = 0;        // in use
  int64_t memory_total_bytes = 0;  // installed
  double utilization = 0;          // share of the last second or so in which it computed, 0..1
  int capability = 0;              // compute capability times ten, 75 is 7.5; 0: the driver does not say
};

// NVML, thread-safe.
class Nvml {
 public:
  // Null if there is no such library, or it finds no driver. `library`: its path, or its name to search for.
  static std::unique_ptr<Nvml> Open(const std::string& library = "libnvidia-ml.so.1");
  ~Nvml();
  Nvml(const Nvml&) = delete;
  Nvml& operator=(const Nvml&) = delete;

  // `gpu` is a number as NVML counts, "0", or an identifier, "GPU-8932f937-...". Nothing if there is no such GPU.
  std::optional<GpuUsage> Read(const std::string& gpu) const;

 private:
  struct Functions;

  Nvml(void* library, std::unique_ptr<Functions> functions);

  void* const library_;
  const std::unique_ptr<Functions> functions_;
};

// "9.0" for a compute capability of 90.
std::string CapabilityText(int capability);

// NVML's name for GPU number `number` as CUDA counts, from 0: an entry of `visible`, the variable CUDA_VISIBLE_DEVICES,
// or the number itself if that is empty.
std::string NvmlName(int number, const std::string& visible);

// Tells the process that it computes on GPU number `number`, as CUDA counts. Thread-safe.
void SetProcessGpu(int number);

// That GPU; nothing without one, or without NVML. Thread-safe.
std::optional<GpuUsage> ReadGpuUsage();

// GPU number `number`, as CUDA counts; nothing without NVML. Thread-safe.
std::optional<GpuUsage> ReadGpuUsage(int number);

}  // namespace craftfleet
