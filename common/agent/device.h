// The device that computes: the CPU or a GPU. Does not include LibTorch.

#pragma once

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Resolves --device=`name` on this machine to LibTorch's notation: "cpu", or "cuda:N" for its GPU number N, as
// nvidia-smi counts. `name` is one of these, "cuda" for the first GPU, or "auto" for the first GPU if there is one and
// the CPU if not.
//   InvalidArgument: it is none of these.   FailedPrecondition: there is no such GPU, or this LibTorch has no CUDA.
absl::StatusOr<std::string> FindDevice(absl::string_view name);

// The same where there are `gpus` GPUs.
absl::StatusOr<std::string> ChooseDevice(absl::string_view name, int gpus);

// Records in `config` that a learner computes its run on `device`, as FindDevice returns it: a new run on a GPU, for
// whose device `config` has no value, gets `on_gpu`. `resumed`: `config` is that of a run that goes on.
//   FailedPrecondition: the run computes on another type of device; says how to go on.
absl::Status SetRunDevice(absl::string_view device, bool resumed, v1::RunConfig::Device on_gpu, v1::RunConfig* config);

// The device, as FindDevice returns it, on which an actor with --device=`name` acts in a run of this type. "auto" is
// what the run wants.
//   FailedPrecondition: the run acts on another type of device.   Others as FindDevice.
absl::StatusOr<std::string> FindActingDevice(absl::string_view name, v1::RunConfig::Device run);

// The same where there are `gpus` GPUs.
absl::StatusOr<std::string> ChooseActingDevice(absl::string_view name, v1::RunConfig::Device run, int gpus);

// Prepares LibTorch to compute on `device`, as FindDevice returns it, with `precision`: on a GPU, algorithms that
// repeat bit for bit. For the whole process.
void SetUpDevice(absl::string_view device, v1::RunConfig::Precision precision);

// InvalidArgument unless `device` can multiply in `precision`.
absl::Status CheckPrecision(absl::string_view device, v1::RunConfig::Precision precision);

// The same for a CPU with these `flags` (of /proc/cpuinfo, one space between two and around them).
absl::Status CheckCpuPrecision(absl::string_view flags, v1::RunConfig::Precision precision);

// The same for a GPU, --device=`device`, of this compute capability times ten; 0: it is not known.
absl::Status CheckGpuPrecision(absl::string_view device, int capability, v1::RunConfig::Precision precision);

// A failure of LibTorch while it computed `task` ("update") for a learner, as one sentence: `what` is the text of its
// exception.
//   ResourceExhausted: out of a GPU's memory; says what to lower.   FailedPrecondition: this LibTorch has no kernels
//   for the GPU.   Unavailable: the GPU or its driver failed.   Internal: anything else.
absl::Status DeviceError(absl::string_view task, absl::string_view what);

// The same in a phase of distillation, where other settings take the memory.
absl::Status DistillingDeviceError(absl::string_view task, absl::string_view what);

// The same for an actor, which can do other things about it.
absl::Status ActingDeviceError(absl::string_view task, absl::string_view what);

}  // namespace craftfleet
