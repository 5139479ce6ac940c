#include "common/telemetry/gpu_usage.h"

#include <dlfcn.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <type_traits>
#include <utility>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>

namespace craftfleet {
namespace {

// The part of NVML's interface (nvml.h) that is used: 0 is success.
using Device = void*;
struct Memory {
  unsigned long long total, free, used;  // NOLINT(google-runtime-int): as in nvml.h
};
struct Utilization {
  unsigned int gpu, memory;  // per cent
};

std::atomic<int> process_gpu{-1};

}  // namespace

struct Nvml::Functions {
  int (*init)();
  int (*shutdown)();
  int (*by_index)(unsigned int, Device*);
  int (*by_uuid)(const char*, Device*);
  int (*name)(Device, char*, unsigned int);
  int (*memory)(Device, Memory*);
  int (*utilization)(Device, Utilization*);
  int (*capability)(Device, int*, int*);  // major and minor number

  // Null if there is no such GPU.
  Device Find(const std::string& gpu) const {
    Device device = nullptr;
    unsigned int index = 0;
    const int error = absl::SimpleAtoi(gpu, &index) ? by_index(index, &device) : by_uuid(gpu.c_str(), &device);
    return error == 0 ? device : nullptr;
  }
};

std::unique_ptr<Nvml> Nvml::Open(const std::string& library) {
  void* const handle = dlopen(library.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr) return nullptr;
  auto functions = std::make_unique<Functions>();
  bool found = true;
  const auto find = [&](const char* name, auto* function) {
    *function = reinterpret_cast<std::remove_pointer_t<decltype(function)>>(dlsym(handle, name));
    found = found && *function != nullptr;
  };
  find("nvmlInit_v2", &functions->init);
  find("nvmlShutdown", &functions->shutdown);
  find("nvmlDeviceGetHandleByIndex_v2", &functions->by_index);
  find("nvmlDeviceGetHandleByUUID", &functions->by_uuid);
  find("nvmlDeviceGetName", &functions->name);
  find("nvmlDeviceGetMemoryInfo", &functions->memory);
  find("nvmlDeviceGetUtilizationRates", &functions->utilization);
  find("nvmlDeviceGetCudaComputeCapability", &functions->capability);
  if (!found || functions->init() != 0) {
    dlclose(handle);
    return nullptr;
  }
  return std::unique_ptr<Nvml>(new Nvml(handle, std::move(functions)));
}

Nvml::Nvml(void* library, std::unique_ptr<Functions> functions) : library_(library), functions_(std::move(functions)) {}

Nvml::~Nvml() {
  functions_->shutdown();
  dlclose(library_);
}

std::optional<GpuUsage> Nvml::Read(const std::string& gpu) const {
  Device const device = functions_->Find(gpu);
  if (device == nullptr) return std::nullopt;
  std::array<char, 97> name = {};
  Memory memory = {};
  if (functions_->name(device, name.data(), name.size() - 1) != 0 || functions_->memory(device, &memory) != 0) {
    return std::nullopt;
  }
  // A slice of a GPU (MIG) has none.
  Utilization utilization = {};
  if (functions_->utilization(device, &utilization) != 0) utilization = {};
  int major = 0;
  int minor = 0;
  if (functions_->capability(device, &major, &minor) != 0) major = minor = 0;
  return GpuUsage{name.data(), static_cast<int64_t>(memory.used), static_cast<int64_t>(memory.total),
                  utilization.gpu / 100.0, 10 * major + minor};
}

std::string CapabilityText(int capability) { return absl::StrCat(capability / 10, ".", capability % 10); }

std::string NvmlName(int number, const std::string& visible) {
  if (visible.empty()) return absl::StrCat(number);
  const std::vector<std::string> names = absl::StrSplit(visible, ',');
  return number < static_cast<int>(names.size()) ? names[number] : absl::StrCat(number);
}

void SetProcessGpu(int number) { process_gpu = number; }

std::optional<GpuUsage> ReadGpuUsage() {
  const int number = process_gpu;
  return number < 0 ? std::nullopt : ReadGpuUsage(number);
}

std::optional<GpuUsage> ReadGpuUsage(int number) {
  static const auto& nvml = *new std::unique_ptr<Nvml>(Nvml::Open());
  const char* const visible = std::getenv("CUDA_VISIBLE_DEVICES");
  return nvml == nullptr ? std::nullopt : nvml->Read(NvmlName(number, visible == nullptr ? "" : visible));
}

}  // namespace craftfleet
