// Whether a device computes what the CPU computes, with which errors, how fast and in how much memory.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <absl/flags/flag.h>
#include <absl/status/status.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>
#include <torch/csrc/autograd/profiler_kineto.h>
#include <torch/version.h>

#include "common/agent/device.h"
#include "common/agent/initial_weights.h"
#include "common/agent/policy.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/process/program.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"
#include "tests/learner/ppo/random_fragments.h"
#include "tests/learner/ppo/saved_tensors.h"

#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 11)
#include <c10/core/CachingDeviceAllocator.h>
#define CRAFTFLEET_HAS_MEMORY_STATS_
#endif

ABSL_FLAG(std::string, device, "auto", "cuda:N; cpu: the CPU as if it were a GPU");
ABSL_FLAG(std::vector<std::string>, agents,
          std::vector<std::string>({"ppo_cnn", "lstm_cnn", "oc_sa", "oc_ca", "ppo_spcnn", "lstm_spcnn", "ppo_resnet",
                                    "grid_distillation"}),
          "agents, in this order");
ABSL_FLAG(std::vector<std::string>, precisions, std::vector<std::string>({"FP32", "TF32", "BF16"}),
          "precisions; those that the device does not have are left out");
ABSL_FLAG(std::vector<std::string>, checks,
          std::vector<std::string>({"update", "act", "repeat", "memory", "speed", "profile"}),
          "what to do, in this order");
ABSL_FLAG(bool, small, false, "small frames and minibatches, for a CPU");
ABSL_FLAG(std::string, profile, "", "folder for a trace of each agent and precision; empty: none");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "device_check";
constexpr char kUsage[] =
    R"(device_check compares updates and acting on a device with those of the CPU, repeats them, stops them, fills the device's memory, and
measures. It prints a line of JSON for each figure: a `value`, and where it is checked its `limit` and whether it is `ok`. Exits with 1
if a figure is not. See deploy/GPU.md.)";
constexpr int kSteps = 8;  // of a fragment
constexpr int kMinibatches = 3;
constexpr int kFewRows = 32;  // of a minibatch

// Errors that count as rounding: of Adam's moments after an update, as a share of their length, and of
// log-probabilities and values. TF32 and BF16 round each factor to 10 and 7 bits. A wrong term shows as 1.
struct Limits {
  v1::RunConfig::Precision precision;
  double moments;
  double outputs;
};
constexpr Limits kLimits[] = {
    {v1::RunConfig::FP32, 1e-3, 1e-4}, {v1::RunConfig::TF32, 0.02, 0.01}, {v1::RunConfig::BF16, 0.1, 0.05}};

class DeviceCheck {
 public:
  DeviceCheck(std::string agent, std::string device, const Limits& limits)
      : agent_(std::move(agent)), device_(std::move(device)), limits_(limits) {}

  // Prints everything about the agent in this precision. What fails is printed too.
  void Run() {
    const std::map<std::string, absl::Status (DeviceCheck::*)()> checks = {
        {"update", &DeviceCheck::CompareUpdate}, {"act", &DeviceCheck::CompareActing},
        {"repeat", &DeviceCheck::Repeat},        {"memory", &DeviceCheck::RunOutOfMemory},
        {"speed", &DeviceCheck::Measure},        {"profile", &DeviceCheck::Profile}};
    for (const std::string& name : absl::GetFlag(FLAGS_checks)) {
      absl::Status status = absl::InvalidArgumentError("no such check");
      try {
        if (checks.count(name) > 0) status = (this->*checks.at(name))();
      } catch (const std::exception& error) {
        status = DeviceError("LibTorch", error.what());
      }
      if (!status.ok()) Print(absl::StrCat(name, ": ", status.message()), 1, 0);
    }
  }

  bool is_good() const { return is_good_; }

 private:
  void Print(absl::string_view figure, double value, std::optional<double> limit = std::nullopt) {
    std::string checked;
    if (limit.has_value()) {
      const bool is_ok = value <= *limit;  // not if it is NaN
      is_good_ = is_good_ && is_ok;
      checked = absl::StrFormat(R"(, "limit": %g, "ok": %s)", *limit, is_ok ? "true" : "false");
    }
    std::string name(figure);
    std::replace(name.begin(), name.end(), '"', '\'');
    absl::PrintF("{\"agent\": \"%s\", \"precision\": \"%s\", \"figure\": \"%s\", \"value\": %s%s}\n", agent_,
                 v1::RunConfig::Precision_Name(limits_.precision), name,
                 std::isfinite(value) ? absl::StrFormat("%.4g", value) : "null", checked);
    std::fflush(stdout);
  }

  v1::RunConfig Config(v1::RunConfig::Precision precision) const {
    v1::RunConfig config = *DefaultRunConfig(agent_);
    config.set_precision(precision);
    config.mutable_ppo()->set_epochs(1);
    if (!absl::GetFlag(FLAGS_small)) return config;
    config.mutable_network()->set_frame_size(absl::EndsWith(agent_, "_cnn") ? 40 : 32);
    config.mutable_ppo()->set_minibatch_size(kFewRows);
    return config;
  }

  // For minibatches of kFewRows, which the CPU computes in good time.
  absl::StatusOr<std::unique_ptr<PpoUpdater>> MakeUpdater(const std::string& device,
                                                          v1::RunConfig::Precision precision) const {
    v1::RunConfig config = Config(precision);
    config.mutable_ppo()->set_minibatch_size(kFewRows);
    return PpoUpdater::Create(config, /*threads=*/device == "cpu" ? 4 : 1, device);
  }
  absl::StatusOr<std::unique_ptr<PpoUpdater>> MakeUpdater() const { return MakeUpdater(device_, limits_.precision); }

  // For minibatches as in training.
  absl::StatusOr<std::unique_ptr<PpoUpdater>> MakeFullUpdater() const {
    return PpoUpdater::Create(Config(limits_.precision), 1, device_);
  }
  int full_rows() const { return kMinibatches * Config(limits_.precision).ppo().minibatch_size(); }

  static absl::StatusOr<UpdateStats> Update(
      int iteration, int rows, PpoUpdater* updater, const std::function<bool()>& should_stop = [] { return false; }) {
    const std::vector<Fragment> played = RandomFragments(*updater, rows / kSteps, 1, kSteps);
    Rollout rollout;
    for (const Fragment& fragment : played) {
      AppendFragment(fragment, updater->rollout_options(), &rollout);
    }
    return updater->Update(iteration, rollout, should_stop);
  }

  static std::string BytesOf(PpoUpdater* updater) { return *updater->SaveWeights() + *updater->SaveOptimizer(); }

  absl::Status CompareUpdate() {
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto expected, MakeUpdater("cpu", v1::RunConfig::FP32));
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto actual, MakeUpdater());
    // One minibatch: rounding in the first step changes the gradient of the second.
    CRAFTFLEET_ASSIGN_OR_RETURN(const UpdateStats expected_stats, Update(0, kFewRows, expected.get()));
    CRAFTFLEET_ASSIGN_OR_RETURN(const UpdateStats actual_stats, Update(0, kFewRows, actual.get()));
    const std::string expected_state = *expected->SaveOptimizer();
    const std::string actual_state = *actual->SaveOptimizer();
    for (const char* name : {"exp_avg.", "exp_avg_sq."}) {
      const at::Tensor moments = SavedTensors(expected_state, name);
      Print(absl::StrCat("update: error of ", name),
            ShareOfWay(SavedTensors(actual_state, name), moments, at::zeros_like(moments)), limits_.moments);
    }
    Print("update: error of the gradient's norm",
          std::abs(actual_stats.gradient_norm / expected_stats.gradient_norm - 1), limits_.moments);
    Print("update: error of the value loss", std::abs(actual_stats.value_loss / expected_stats.value_loss - 1),
          limits_.moments);
    return absl::OkStatus();
  }

  // Of the initial weights.
  absl::StatusOr<std::unique_ptr<const Policy>> MakePolicy(const std::string& device,
                                                           v1::RunConfig::Precision precision, int tile) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(Config(precision)));
    if (weights_.empty()) weights_ = SaveWeights(spec, InitialWeights(spec, /*seed=*/1));
    return Policy::Create(spec, weights_, tile, device);
  }

  // Acts `times` times on the same frames, with the states that follow.
  absl::StatusOr<ActResult> Act(const Policy& policy, int lanes, int times) const {
    CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(Config(limits_.precision)));
    const std::string frames = GoldenFrames(7, lanes, spec.frame_size);
    std::vector<int> all(lanes);
    for (int lane = 0; lane < lanes; ++lane) all[lane] = lane;
    std::vector<float> states(static_cast<size_t>(lanes) * spec.state_size);
    absl::StatusOr<ActResult> result;
    for (int i = 0; i < times; ++i) {
      result = policy.Act(frames, all, /*noise=*/{}, absl::MakeSpan(states));
      CRAFTFLEET_RETURN_IF_ERROR(result.status());
    }
    return result;
  }

  absl::Status CompareActing() {
    constexpr int kLanes = 16;
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto on_cpu, MakePolicy("cpu", v1::RunConfig::FP32, kLanes));
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto there, MakePolicy(device_, limits_.precision, kLanes));
    CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult expected, Act(*on_cpu, kLanes, 2));
    CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult actual, Act(*there, kLanes, 2));
    double of_log_probs = 0;
    double of_values = 0;
    for (int lane = 0; lane < kLanes; ++lane) {
      for (int action = 0; action < kNumActions; ++action) {
        of_log_probs = std::max<double>(
            of_log_probs, std::abs(actual.odds[lane].log_probs[action] - expected.odds[lane].log_probs[action]));
      }
      of_values = std::max<double>(of_values, std::abs(actual.values[lane] - expected.values[lane]));
    }
    Print("act: error of log-probabilities", of_log_probs, limits_.outputs);
    Print("act: error of values", of_values, limits_.outputs);
    return absl::OkStatus();
  }

  // Two equal updaters, of which one is stopped in between.
  absl::Status Repeat() {
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto once, MakeUpdater());
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto stopped, MakeUpdater());
    for (int iteration = 0; iteration < 2; ++iteration) {
      const std::string before = BytesOf(stopped.get());
      const absl::Status status = Update(iteration, 2 * kFewRows, stopped.get(), [] { return true; }).status();
      if (!absl::IsCancelled(status)) return absl::InternalError(absl::StrCat("not stopped: ", status.message()));
      Print("repeat: a stopped update changes something", before == BytesOf(stopped.get()) ? 0 : 1, 0);
      CRAFTFLEET_RETURN_IF_ERROR(Update(iteration, 2 * kFewRows, once.get()).status());
      CRAFTFLEET_RETURN_IF_ERROR(Update(iteration, 2 * kFewRows, stopped.get()).status());
    }
    Print("repeat: equal updates differ", BytesOf(once.get()) == BytesOf(stopped.get()) ? 0 : 1, 0);
    return absl::OkStatus();
  }

  // Fills the GPU's memory, and goes on when it is free again.
  absl::Status RunOutOfMemory() {
    if (!at::Device(device_).is_cuda()) return absl::OkStatus();
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto updater, MakeFullUpdater());
    CRAFTFLEET_RETURN_IF_ERROR(Update(0, full_rows(), updater.get()).status());
    const std::string before = BytesOf(updater.get());
    std::vector<at::Tensor> hog;
    for (int64_t bytes = int64_t{1} << 34; bytes >= int64_t{1} << 20;) {
      try {
        hog.push_back(at::empty({bytes}, at::TensorOptions(at::kByte).device(at::Device(device_))));
      } catch (const std::exception&) {
        bytes /= 2;
      }
    }
    const absl::Status status = Update(1, full_rows(), updater.get()).status();
    hog.clear();
    Print(absl::StrCat("memory: a full GPU is not reported: ", status.message()),
          absl::IsResourceExhausted(status) ? 0 : 1, 0);
    Print("memory: an update without memory changes something", before == BytesOf(updater.get()) ? 0 : 1, 0);
    return Update(1, full_rows(), updater.get()).status();
  }

  absl::Status Measure() {
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto updater, MakeFullUpdater());
    CRAFTFLEET_RETURN_IF_ERROR(Update(0, full_rows(), updater.get()).status());
    ResetPeak();
    const int64_t steps = updater->optimizer_steps();
    const absl::Time start = absl::Now();
    CRAFTFLEET_RETURN_IF_ERROR(Update(1, full_rows(), updater.get()).status());
    Print("speed: ms a minibatch, rollout and weights copied",
          absl::ToDoubleMilliseconds(absl::Now() - start) / static_cast<double>(updater->optimizer_steps() - steps));
    PrintPeak();
    const int lanes = Config(limits_.precision).lanes();
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto policy, MakePolicy(device_, limits_.precision, lanes));
    CRAFTFLEET_RETURN_IF_ERROR(Act(*policy, lanes, 2).status());
    const absl::Time first_act = absl::Now();
    CRAFTFLEET_RETURN_IF_ERROR(Act(*policy, lanes, 10).status());
    Print(absl::StrCat("speed: ms an act of ", lanes, " lanes"),
          absl::ToDoubleMilliseconds(absl::Now() - first_act) / 10);
    return absl::OkStatus();
  }

  void ResetPeak() const {
#ifdef CRAFTFLEET_HAS_MEMORY_STATS_
    const at::Device device(device_);
    if (device.is_cuda()) c10::getDeviceAllocator(device.type())->resetPeakStats(device.index());
#endif
  }
  void PrintPeak() {
#ifdef CRAFTFLEET_HAS_MEMORY_STATS_
    const at::Device device(device_);
    if (!device.is_cuda()) return;
    const auto stats = c10::getDeviceAllocator(device.type())->getDeviceStats(device.index());
    Print("memory: peak of an update, MiB", static_cast<double>(stats.allocated_bytes[0].peak) / (1 << 20));
#endif
  }

  // A trace of three minibatches and ten acts, for chrome://tracing.
  absl::Status Profile() {
    const std::string folder = absl::GetFlag(FLAGS_profile);
    if (folder.empty()) return absl::OkStatus();
    namespace profiler = torch::profiler::impl;
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto updater, MakeFullUpdater());
    CRAFTFLEET_RETURN_IF_ERROR(Update(0, full_rows(), updater.get()).status());
    const int lanes = Config(limits_.precision).lanes();
    CRAFTFLEET_ASSIGN_OR_RETURN(const auto policy, MakePolicy(device_, limits_.precision, lanes));
    const profiler::ProfilerConfig config(profiler::ProfilerState::KINETO);
    std::set<profiler::ActivityType> activities = {profiler::ActivityType::CPU};
    if (at::Device(device_).is_cuda()) activities.insert(profiler::ActivityType::CUDA);
    torch::autograd::profiler::prepareProfiler(config, activities);
    torch::autograd::profiler::enableProfiler(config, activities);
    const absl::Status updated = Update(1, full_rows(), updater.get()).status();
    const absl::Status acted = Act(*policy, lanes, 10).status();
    const auto result = torch::autograd::profiler::disableProfiler();
    CRAFTFLEET_RETURN_IF_ERROR(updated);
    CRAFTFLEET_RETURN_IF_ERROR(acted);
    try {
      result->save(absl::StrCat(folder, "/", agent_, "-", v1::RunConfig::Precision_Name(limits_.precision), ".json"));
    } catch (const std::exception&) {  // of Debian's LibTorch, which was built without Kineto
      if (at::Device(device_).is_cuda()) throw;
      Print("profile: this LibTorch makes no traces", 0);
    }
    Print("profile: events", static_cast<double>(result->events().size()));
    return absl::OkStatus();
  }

  const std::string agent_;
  const std::string device_;
  const Limits limits_;
  std::string weights_;
  bool is_good_ = true;
};

absl::Status Run() {
  std::string device = absl::GetFlag(FLAGS_device);
  if (device == "cpu") {
    device = "cpu:0";
  } else if (device != "privateuseone:0") {  // the stand-in of tests
    CRAFTFLEET_ASSIGN_OR_RETURN(device, FindDevice(device));
  }
  SetUpTorchThread();
  bool is_good = true;
  for (const std::string& agent : absl::GetFlag(FLAGS_agents)) {
    CRAFTFLEET_RETURN_IF_ERROR(DefaultRunConfig(agent).status());
    for (const Limits& limits : kLimits) {
      const std::vector<std::string> wanted = absl::GetFlag(FLAGS_precisions);
      if (std::count(wanted.begin(), wanted.end(), v1::RunConfig::Precision_Name(limits.precision)) == 0) continue;
      if (!CheckPrecision(device, limits.precision).ok()) continue;
      SetUpDevice(device, limits.precision);
      DeviceCheck check(agent, device, limits);
      check.Run();
      is_good = is_good && check.is_good();
    }
  }
  return is_good ? absl::OkStatus() : absl::DataLossError("a figure is beyond its limit, see above");
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({craftfleet::kProgram, craftfleet::kUsage}, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
