#include "common/agent/device.h"

#include <cstdlib>
#include <string>

#include <ATen/Context.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/version.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(ChooseDevice, PrefersAGpu) {
  EXPECT_EQ(*ChooseDevice("auto", 0), "cpu");
  EXPECT_EQ(*ChooseDevice("auto", 2), "cuda:0");
  EXPECT_EQ(*ChooseDevice("cpu", 2), "cpu");
  EXPECT_EQ(*ChooseDevice("cuda", 2), "cuda:0");
  EXPECT_EQ(*ChooseDevice("cuda:1", 2), "cuda:1");
}

TEST(ChooseDevice, ErrorsNameTheFlagAndValue) {
  for (const char* name : {"", "gpu", "cuda:", "cuda:x", "cuda:-1", "cuda1", "CUDA", "cpu:0"}) {
    EXPECT_THAT(ChooseDevice(name, 2),
                StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr(std::string("--device=") + name),
                                                                   HasSubstr("want auto, cpu, cuda or cuda:N"))))
        << name;
  }
  EXPECT_THAT(ChooseDevice("cuda:2", 2),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("there are 2 GPUs")));
  EXPECT_THAT(ChooseDevice("cuda", 0), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("there are 0 GPUs")));
}

// The texts of LibTorch 2.11 and CUDA 13, of each kind one or two.
TEST(DeviceError, IsOneSentenceThatSaysWhatToDo) {
  const auto error = [](const std::string& text) { return DeviceError("update", text); };
  for (const char* text :
       {"CUDA out of memory. Tried to allocate 512.00 MiB", "cuDNN error: CUDNN_STATUS_ALLOC_FAILED"}) {
    EXPECT_THAT(error(absl::StrCat(text, ".\nException raised from malloc\nframe #0: ...")),
                StatusIs(absl::StatusCode::kResourceExhausted,
                         AllOf(HasSubstr("lower ppo.minibatch_size"), HasSubstr(text), Not(HasSubstr("frame")))));
  }
  EXPECT_THAT(
      error("CUDA error: no kernel image is available for execution on the device\nCUDA kernel errors"),
      StatusIs(absl::StatusCode::kFailedPrecondition,
               AllOf(HasSubstr("update: this LibTorch has no kernels for this GPU"), HasSubstr("--device=cpu"))));
  EXPECT_THAT(error("CUDA error: unspecified launch failure"),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("nvidia-smi")));
  EXPECT_THAT(error("shapes differ\nframe #0"),
              StatusIs(absl::StatusCode::kInternal, testing::StrEq("update: shapes differ")));
}

TEST(DistillingDeviceError, SaysWhatAPhaseOfDistillationNeedsMemoryFor) {
  EXPECT_THAT(DistillingDeviceError("distillation", "CUDA out of memory. Tried to allocate 512.00 MiB"),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       AllOf(HasSubstr("lower distillation.minibatch_size, then distillation.every_iterations"),
                             Not(HasSubstr("ppo.minibatch_size")))));
  EXPECT_EQ(DistillingDeviceError("update", "CUDA error: unspecified launch failure"),
            DeviceError("update", "CUDA error: unspecified launch failure"));
}

TEST(ActingDeviceError, SaysWhatAnActorCanDo) {
  const auto error = [](const std::string& text) { return ActingDeviceError("policy", text); };
  EXPECT_THAT(error("CUDA out of memory. Tried to allocate 512.00 MiB"),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       AllOf(HasSubstr("fewer actors"), Not(HasSubstr("ppo.minibatch_size")))));
  EXPECT_THAT(error("CUDA error: no kernel image is available for execution on the device"),
              StatusIs(absl::StatusCode::kFailedPrecondition, Not(HasSubstr("--device=cpu"))));
  EXPECT_THAT(error("CUDA error: unspecified launch failure"),
              StatusIs(absl::StatusCode::kUnavailable, AllOf(HasSubstr("nvidia-smi"), Not(HasSubstr("--resume")))));
}

// Once there are threads, the environment must not change.
TEST(SetUpDevice, FindsTheEnvironmentSet) {
  EXPECT_STREQ(std::getenv("CUDA_DEVICE_ORDER"), "PCI_BUS_ID");
  EXPECT_STREQ(std::getenv("CUBLAS_WORKSPACE_CONFIG"), ":4096:8");
}

#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 11)
TEST(SetUpDevice, AddsProductsOfBf16InFloat32) {
  SetUpDevice("privateuseone:0", v1::RunConfig::BF16);
  EXPECT_NE(at::globalContext().allowBF16ReductionCuBLAS(), at::CuBLASReductionOption::AllowReducedPrecisionWithSplitK);
  at::globalContext().setDeterministicAlgorithms(false, false);
}
#endif

TEST(SetRunDevice, ARunStaysOnItsTypeOfDevice) {
  using v1::RunConfig;
  RunConfig config;
  EXPECT_THAT(SetRunDevice("cpu", false, RunConfig::CUDA, &config), IsOk());
  EXPECT_FALSE(config.has_device());
  EXPECT_THAT(SetRunDevice("cuda:0", true, RunConfig::CUDA, &config),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("the run computes on the CPU"), HasSubstr("--init_from"))));
  EXPECT_FALSE(config.has_device());
  EXPECT_THAT(SetRunDevice("cuda:0", false, RunConfig::CUDA_UPDATES, &config), IsOk());
  EXPECT_EQ(config.device(), RunConfig::CUDA_UPDATES);
  EXPECT_THAT(SetRunDevice("cuda:1", true, RunConfig::CUDA, &config), IsOk());
  EXPECT_EQ(config.device(), RunConfig::CUDA_UPDATES);
  EXPECT_THAT(SetRunDevice("cpu", true, RunConfig::CUDA, &config),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("the run computes on a GPU (device: CUDA_UPDATES)"), HasSubstr("--init_from"))));
  config.set_device(RunConfig::CPU);
  EXPECT_THAT(SetRunDevice("cuda:0", false, RunConfig::CUDA, &config),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("--device=cpu")));
}

TEST(ChooseActingDevice, IsWhatTheRunActsOn) {
  using v1::RunConfig;
  for (const RunConfig::Device on_cpus : {RunConfig::DEVICE_UNSPECIFIED, RunConfig::CPU, RunConfig::CUDA_UPDATES}) {
    EXPECT_EQ(*ChooseActingDevice("auto", on_cpus, 2), "cpu");
    EXPECT_EQ(*ChooseActingDevice("cpu", on_cpus, 2), "cpu");
    for (const int gpus : {0, 2}) {
      EXPECT_THAT(ChooseActingDevice("cuda", on_cpus, gpus),
                  StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("--device=cuda: the run acts on CPUs")));
    }
    EXPECT_THAT(ChooseActingDevice("gpu", on_cpus, 2),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want auto")));
  }
  EXPECT_EQ(*ChooseActingDevice("auto", RunConfig::CUDA, 2), "cuda:0");
  EXPECT_EQ(*ChooseActingDevice("cuda:1", RunConfig::CUDA, 2), "cuda:1");
  EXPECT_THAT(ChooseActingDevice("cuda", RunConfig::CUDA, 0),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("--device=cuda: there are 0 GPUs")));
  for (const char* name : {"auto", "cpu"}) {
    EXPECT_THAT(ChooseActingDevice(name, RunConfig::CUDA, 0),
                StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("the run acts on GPUs (device: CUDA)")));
  }
}

TEST(FindActingDevice, RefusesAGpuWhereTheRunActsOnCpus) {
  EXPECT_THAT(FindActingDevice("cuda", v1::RunConfig::CPU),
              StatusIs(absl::StatusCode::kFailedPrecondition, testing::EndsWith("want --device=auto or cpu")));
}

TEST(FindActingDevice, SaysThatLibTorchLacksCudaWhereTheRunActsOnGpus) {
  if (at::hasCUDA()) GTEST_SKIP() << "this LibTorch has CUDA";
  EXPECT_THAT(FindActingDevice("cuda", v1::RunConfig::CUDA),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("--device=cuda: LibTorch was built without CUDA"), Not(HasSubstr("=cpu")))));
  EXPECT_THAT(FindDevice("cuda"), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("or use --device=cpu")));
}

TEST(CheckPrecision, IsWhatTheCpuHas) {
  using v1::RunConfig;
  EXPECT_THAT(CheckCpuPrecision("", RunConfig::FP32), IsOk());
  EXPECT_THAT(CheckCpuPrecision(" avx512_bf16 ", RunConfig::TF32),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("precision is TF32")));
  EXPECT_THAT(CheckCpuPrecision(" avx512_bf16 ", RunConfig::BF16), IsOk());
  EXPECT_THAT(CheckCpuPrecision(" amx_bf16 amx_tile ", RunConfig::BF16), IsOk());
  EXPECT_THAT(CheckCpuPrecision(" avx512f avx512_bf16x ", RunConfig::BF16),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want FP32")));
  EXPECT_THAT(CheckPrecision("cpu", RunConfig::FP32), IsOk());
  EXPECT_THAT(CheckPrecision("cpu", RunConfig::TF32),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("precision is TF32")));
}

TEST(CheckPrecision, IsWhatTheGpuHas) {
  using v1::RunConfig;
  for (const RunConfig::Precision precision : {RunConfig::FP32, RunConfig::TF32, RunConfig::BF16}) {
    EXPECT_THAT(CheckGpuPrecision("cuda:0", 80, precision), IsOk());
    EXPECT_THAT(CheckGpuPrecision("cuda:0", 120, precision), IsOk());
    EXPECT_THAT(CheckGpuPrecision("cuda:0", 0, precision), IsOk()) << "not known";
  }
  EXPECT_THAT(CheckGpuPrecision("cuda:1", 75, RunConfig::FP32), IsOk());
  EXPECT_THAT(CheckGpuPrecision("cuda:1", 75, RunConfig::TF32),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       testing::StrEq("precision is TF32, which GPUs have from compute capability 8.0 on, and "
                                      "--device=cuda:1 has 7.5, want FP32")));
  EXPECT_THAT(
      CheckGpuPrecision("cuda:0", 61, RunConfig::BF16),
      StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("precision is BF16"), HasSubstr("has 6.1"))));
}

TEST(FindDevice, ReportsALibTorchWithoutCuda) {
  EXPECT_THAT(FindDevice("auto"), IsOk());
  if (at::hasCUDA()) GTEST_SKIP() << "this LibTorch has CUDA";
  EXPECT_EQ(*FindDevice("auto"), "cpu");
  EXPECT_THAT(FindDevice("cuda:x"), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("cuda or cuda:N")));
  EXPECT_THAT(FindDevice("cuda:0"), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("without CUDA")));
}

}  // namespace
}  // namespace craftfleet
