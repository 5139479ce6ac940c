#include "common/agent/device.h"

#include <cstdlib>
#include <fstream>
#include <limits>
#include <string>
#include <utility>

#include <ATen/Context.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>
#include <torch/version.h>

#include "common/base/status_macros.h"
#include "common/telemetry/gpu_usage.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kCpu = "cpu";
constexpr int kLeastNarrowCapability = 80;  // of TF32 and BF16

// Before main, because the environment must not change once there are threads. CUDA then numbers GPUs as NVIDIA's
// driver and nvidia-smi do, not from the fastest on, and cuBLAS adds in a fixed order.
[[maybe_unused]] const bool is_environment_set = [] {
  ::setenv("CUDA_DEVICE_ORDER", "PCI_BUS_ID", /*overwrite=*/0);
  ::setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8", /*overwrite=*/0);
  return true;
}();

// What one can do about a GPU that fails.
struct Advice {
  absl::string_view memory;   // when its memory does not suffice
  absl::string_view kernels;  // when LibTorch has none for it, besides building against another one
  absl::string_view restart;  // when it failed
};
constexpr Advice kUpdating = {
    "lower ppo.minibatch_size first, then ppo.rollout_steps and lanes, or end other programs on this GPU",
    ", or use --device=cpu", "start again with --resume"};
constexpr Advice kDistilling = {"lower distillation.minibatch_size, then distillation.every_iterations",
                                kUpdating.kernels, kUpdating.restart};
constexpr Advice kActing = {"end other programs on this GPU, or run fewer actors on it", "", "start the actor again"};

absl::Status ErrorWith(const Advice& advice, absl::string_view task, absl::string_view what) {
  // Behind the first line are pages of advice and a stack trace.
  const absl::string_view line = what.substr(0, what.find('\n'));
  const auto says = [what](absl::string_view text) { return absl::StrContains(what, text); };
  // cuBLAS and cuDNN have no words for it; for want of memory cuDNN finds no algorithm at all.
  if (says("out of memory") || says("ALLOC_FAILED") || says("unable to find an engine")) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("%s: the GPU's memory does not suffice: %s (%s)", task, advice.memory, line));
  }
  if (says("no kernel image is available")) {
    return absl::FailedPreconditionError(
        absl::StrFormat("%s: this LibTorch has no kernels for this GPU: build against one that names its compute "
                        "capability (-DCRAFTFLEET_LIBTORCH=DIR)%s (%s)",
                        task, advice.kernels, line));
  }
  if (says("CUDA error") || says("CUDNN_STATUS") || says("CUBLAS_STATUS")) {
    return absl::UnavailableError(absl::StrFormat(
        "%s: the GPU or its driver failed, see nvidia-smi and the kernel's log; %s (%s)", task, advice.restart, line));
  }
  return absl::InternalError(absl::StrFormat("%s: %s", task, line));
}

// `device` for --device=`name`, or why there is no such GPU if LibTorch lacks CUDA, and what to do `otherwise`.
absl::StatusOr<std::string> OrWithoutCuda(absl::string_view name, absl::StatusOr<std::string> device,
                                          absl::string_view otherwise) {
  if (at::hasCUDA() || !absl::IsFailedPrecondition(device.status()) || !absl::StartsWith(name, "cuda")) return device;
  return absl::FailedPreconditionError(
      absl::StrFormat("--device=%s: LibTorch was built without CUDA or finds no driver: build against one that has it "
                      "(-DCRAFTFLEET_LIBTORCH=DIR)%s",
                      name, otherwise));
}

}  // namespace

absl::StatusOr<std::string> FindDevice(absl::string_view name) {
  return OrWithoutCuda(name, ChooseDevice(name, static_cast<int>(at::getNumGPUs())), ", or use --device=cpu");
}

absl::StatusOr<std::string> ChooseDevice(absl::string_view name, int gpus) {
  if (name == kCpu || (name == "auto" && gpus == 0)) return std::string(kCpu);
  absl::string_view digits = name == "auto" || name == "cuda" ? "cuda:0" : name;
  int number = 0;
  if (!absl::ConsumePrefix(&digits, "cuda:") || !absl::SimpleAtoi(digits, &number) || number < 0) {
    return absl::InvalidArgumentError(absl::StrFormat("--device=%s, want auto, cpu, cuda or cuda:N", name));
  }
  if (number >= gpus) {
    return absl::FailedPreconditionError(
        absl::StrFormat("--device=%s: there are %d GPUs, numbered from 0", name, gpus));
  }
  return absl::StrCat("cuda:", number);
}

absl::Status SetRunDevice(absl::string_view device, bool resumed, v1::RunConfig::Device on_gpu, v1::RunConfig* config) {
  const bool of_gpu = config->has_device() && config->device() != v1::RunConfig::CPU;
  if (of_gpu && device == kCpu) {
    return absl::FailedPreconditionError(
        absl::StrFormat("the run computes on a GPU (device: %s) and this learner on the CPU: run it where LibTorch "
                        "finds a GPU, or start a new run without this field (--init_from keeps the weights)",
                        v1::RunConfig::Device_Name(config->device())));
  }
  if (device == kCpu || of_gpu) return absl::OkStatus();
  if (resumed || config->has_device()) {
    return absl::FailedPreconditionError(
        absl::StrFormat("--device=%s: the run computes on the CPU: use --device=cpu, or start a new run with its "
                        "weights (--init_from)",
                        device));
  }
  config->set_device(on_gpu);
  return absl::OkStatus();
}

absl::StatusOr<std::string> FindActingDevice(absl::string_view name, v1::RunConfig::Device run) {
  absl::StatusOr<std::string> device = ChooseActingDevice(name, run, static_cast<int>(at::getNumGPUs()));
  return run == v1::RunConfig::CUDA ? OrWithoutCuda(name, std::move(device), "") : device;
}

absl::StatusOr<std::string> ChooseActingDevice(absl::string_view name, v1::RunConfig::Device run, int gpus) {
  if (run != v1::RunConfig::CUDA) {
    if (name == "auto") return std::string(kCpu);
    CRAFTFLEET_ASSIGN_OR_RETURN(std::string device, ChooseDevice(name, std::numeric_limits<int>::max()));
    if (device == kCpu) return device;
    return absl::FailedPreconditionError(
        absl::StrCat("--device=", name, ": the run acts on CPUs, want --device=auto or cpu"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string device, ChooseDevice(name, gpus));
  if (device != kCpu) return device;
  return absl::FailedPreconditionError(
      absl::StrCat("--device=", name,
                   ": the run acts on GPUs (device: CUDA), and this is the CPU: run the actor where LibTorch finds a "
                   "GPU (craftfleet doctor)"));
}

void SetUpDevice(absl::string_view device, v1::RunConfig::Precision precision) {
  if (device == kCpu) return;
  int number = 0;
  if (absl::ConsumePrefix(&device, "cuda:") && absl::SimpleAtoi(device, &number)) SetProcessGpu(number);
  at::Context& context = at::globalContext();
  // A warning, not an error: the only such computation, the gradient of max pooling, adds in a fixed order for the
  // layout in which nets/resnet.cc calls it.
  context.setDeterministicAlgorithms(true, /*warn_only=*/true);
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 2)
  // Else every new tensor is filled first.
  context.setDeterministicFillUninitializedMemory(false);
#endif
  context.setDeterministicCuDNN(true);
  context.setBenchmarkCuDNN(false);
  const bool tf32 = precision == v1::RunConfig::TF32;
  context.setAllowTF32CuBLAS(tf32);
  context.setAllowTF32CuDNN(tf32);
#if TORCH_VERSION_MAJOR >= 2
  context.setAllowBF16ReductionCuBLAS(false);  // products of bfloat16 are added in float32
#endif
}

absl::Status CheckPrecision(absl::string_view device, v1::RunConfig::Precision precision) {
  absl::string_view digits = device;
  int number = 0;
  if (absl::ConsumePrefix(&digits, "cuda:") && absl::SimpleAtoi(digits, &number)) {
    return CheckGpuPrecision(device, ReadGpuUsage(number).value_or(GpuUsage()).capability, precision);
  }
  if (!absl::StartsWith(device, kCpu)) return absl::OkStatus();  // the stand-in of tests
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);) {
    if (absl::StartsWith(line, "flags")) return CheckCpuPrecision(absl::StrCat(line, " "), precision);
  }
  return CheckCpuPrecision("", precision);
}

absl::Status CheckCpuPrecision(absl::string_view flags, v1::RunConfig::Precision precision) {
  if (precision == v1::RunConfig::TF32) {
    return absl::InvalidArgumentError("precision is TF32, which only GPUs have, want FP32 or BF16 on the CPU");
  }
  const bool has_bf16 = absl::StrContains(flags, " avx512_bf16 ") || absl::StrContains(flags, " amx_bf16 ");
  if (precision == v1::RunConfig::BF16 && !has_bf16) {
    return absl::InvalidArgumentError(
        "precision is BF16, and this CPU has neither avx512_bf16 nor amx_bf16 (/proc/cpuinfo), want FP32");
  }
  return absl::OkStatus();
}

absl::Status CheckGpuPrecision(absl::string_view device, int capability, v1::RunConfig::Precision precision) {
  const bool is_narrow = precision == v1::RunConfig::TF32 || precision == v1::RunConfig::BF16;
  if (!is_narrow || capability == 0 || capability >= kLeastNarrowCapability) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat(
      "precision is %s, which GPUs have from compute capability %s on, and --device=%s has %s, want FP32",
      v1::RunConfig::Precision_Name(precision), CapabilityText(kLeastNarrowCapability), device,
      CapabilityText(capability)));
}

absl::Status DeviceError(absl::string_view task, absl::string_view what) { return ErrorWith(kUpdating, task, what); }

absl::Status DistillingDeviceError(absl::string_view task, absl::string_view what) {
  return ErrorWith(kDistilling, task, what);
}

absl::Status ActingDeviceError(absl::string_view task, absl::string_view what) {
  return ErrorWith(kActing, task, what);
}

}  // namespace craftfleet
