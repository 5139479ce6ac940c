// What training needs of a GPU: products, memory traffic and computations, counted on the stand-in device, and the
// least time that they take at given speeds of a GPU.

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include <ATen/core/Tensor.h>
#include <ATen/core/ivalue.h>
#include <absl/flags/flag.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/agent/initial_weights.h"
#include "common/agent/policy.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/process/program.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"

ABSL_FLAG(std::vector<std::string>, agents,
          std::vector<std::string>({"ppo_cnn", "lstm_cnn", "ppo_spcnn", "lstm_spcnn", "oc_sa", "oc_ca", "ppo_resnet"}),
          "agents, with their own configurations");
ABSL_FLAG(std::vector<std::string>, tflops, std::vector<std::string>({"66.9", "494.7", "989.4"}),
          "products of the GPU, TFLOP/s, in FP32, TF32 and BF16; default: an H100 SXM, dense");
ABSL_FLAG(double, terabytes_per_second, 3.35, "memory of the GPU; default: an H100 SXM");
ABSL_FLAG(int32_t, names, 0, "kinds of computations to print, those that take longest in FP32 first");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "roofline_bench";
constexpr char kUsage[] =
    R"(roofline_bench counts what training an agent needs of a GPU: floating-point operations of products (convolutions and matrices), bytes
that computations read and write, and computations. It prints the least time that a million steps take: each computation at the
speed of products or of memory, whichever takes longer. Needs no GPU; see tests/bench/README.md.)";
constexpr size_t kPrecisions = 3;

// Of computations in float32; the products of the other precisions read and write at most as many bytes.
struct Cost {
  double computations = 0;
  double flop = 0;
  double bytes = 0;
  std::array<double, kPrecisions> seconds = {};  // in each precision

  void Add(const Cost& other, double factor = 1) {
    computations += factor * other.computations;
    flop += factor * other.flop;
    bytes += factor * other.bytes;
    for (size_t i = 0; i < kPrecisions; ++i) seconds[i] += factor * other.seconds[i];
  }
};

// By the name of the computation, such as "aten::mm".
using Costs = std::map<std::string, Cost>;

void Add(const Costs& others, double factor, Costs* costs) {
  for (const auto& [name, cost] : others) (*costs)[name].Add(cost, factor);
}

Cost Sum(const Costs& costs) {
  Cost sum;
  for (const auto& [name, cost] : costs) sum.Add(cost);
  return sum;
}

struct Speeds {
  std::array<double, kPrecisions> flop_per_second = {};
  double bytes_per_second = 0;
};

// A multiplication and an addition are two operations.
double FlopOf(absl::string_view name, const std::vector<c10::IValue>& arguments,
              const std::vector<at::Tensor>& results) {
  const auto tensor = [&](int i) { return arguments[i].toTensor(); };
  const auto per_output = [](const at::Tensor& weight) {
    return 2 * static_cast<double>(weight.numel()) / static_cast<double>(weight.size(0));
  };
  if (name == "aten::convolution") return per_output(tensor(1)) * static_cast<double>(results[0].numel());
  if (name == "aten::convolution_backward") {  // the gradients of the input and of the weight, where they are wanted
    const auto wanted = arguments.back().toBoolList();
    return per_output(tensor(2)) * static_cast<double>(tensor(0).numel()) * (int{wanted[0]} + int{wanted[1]});
  }
  const bool adds = name == "aten::addmm" || name == "aten::baddbmm";
  if (!adds && name != "aten::mm" && name != "aten::bmm") return 0;
  return 2.0 * static_cast<double>(tensor(adds ? 1 : 0).size(-1)) * static_cast<double>(results[0].numel());
}

double BytesOf(absl::string_view name, const std::vector<c10::IValue>& arguments,
               const std::vector<at::Tensor>& results) {
  const auto bytes = [](const at::Tensor& tensor) {
    return tensor.defined() ? static_cast<double>(tensor.nbytes()) : 0.0;
  };
  double written = 0;
  for (const at::Tensor& tensor : results) written += bytes(tensor);
  if (absl::StrContains(name, "index")) return 2 * written;  // reads the rows that it writes
  double read = 0;
  for (const c10::IValue& argument : arguments) {
    if (argument.isTensor()) read += bytes(argument.toTensor());
    if (!argument.isTensorList()) continue;
    for (const at::Tensor& tensor : argument.toTensorVector()) read += bytes(tensor);
  }
  return results.empty() ? 2 * read : read + written;  // without a result it writes to its arguments
}

// What the device computes during `call`.
absl::StatusOr<Costs> CostsOf(const Speeds& speeds, const std::function<absl::Status()>& call) {
  Costs costs;
  ObserveComputations(
      [&](absl::string_view name, const std::vector<c10::IValue>& arguments, const std::vector<at::Tensor>& results) {
        const double flop = FlopOf(name, arguments, results);
        const double bytes = BytesOf(name, arguments, results);
        Cost one = {1, flop, bytes, {}};
        for (size_t i = 0; i < kPrecisions; ++i) {
          one.seconds[i] = std::max(flop / speeds.flop_per_second[i], bytes / speeds.bytes_per_second);
        }
        costs[std::string(name)].Add(one);
      });
  const absl::Status status = call();
  ObserveComputations(nullptr);
  CRAFTFLEET_RETURN_IF_ERROR(status);
  return costs;
}

// An update with one epoch of `minibatches` minibatches, without distillation.
absl::StatusOr<Costs> CostsOfUpdate(const Speeds& speeds, v1::RunConfig config, int minibatches) {
  config.mutable_ppo()->set_epochs(1);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<PpoUpdater> updater,
                              PpoUpdater::Create(config, /*threads=*/1, kStandInDevice));
  const AgentSpec& spec = updater->spec();
  const int steps = std::min(config.fragment_steps(), config.ppo().minibatch_size());
  const int states = updater->rollout_options().every_state ? steps : 1;
  std::vector<Fragment> fragments(minibatches * config.ppo().minibatch_size() / steps);
  Rollout rollout;
  for (size_t i = 0; i < fragments.size(); ++i) {
    Fragment& fragment = fragments[i];
    fragment.lane = static_cast<int>(i);
    fragment.frames = GoldenFrames(1 + i, steps, spec.frame_size);
    fragment.states.assign(size_t{1} * states * spec.state_size, 0);
    fragment.actions.assign(steps, 0);
    fragment.log_probs.assign(steps, -2.8F);
    fragment.values.assign(steps, 0);
    fragment.rewards = GoldenUniforms(absl::StrCat("rewards", i), steps, -1, 1);
    fragment.ends.assign(steps, StepEnd::kNone);
    AppendFragment(fragment, updater->rollout_options(), &rollout);
  }
  return CostsOf(speeds, [&] { return updater->Update(0, rollout, [] { return false; }).status(); });
}

// Acting with half of the run's lanes, as an actor on a GPU does.
absl::StatusOr<Costs> CostsOfPlay(const Speeds& speeds, const v1::RunConfig& config, int rows) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<const Policy> policy,
                              Policy::Create(spec, SaveWeights(spec, InitialWeights(spec, 1)), rows, kStandInDevice));
  const std::string frames = GoldenFrames(1, rows, spec.frame_size);
  std::vector<int> lanes(rows);
  std::iota(lanes.begin(), lanes.end(), 0);
  std::vector<float> states(size_t{1} * rows * spec.state_size);
  return CostsOf(speeds, [&] {
    return policy->Act(frames, lanes, std::vector<double>(rows, 0.5), absl::MakeSpan(states)).status();
  });
}

// A million steps, in each precision.
std::string LeastTimes(const Cost& cost, double steps) {
  std::string text;
  for (const double seconds : cost.seconds) absl::StrAppendFormat(&text, " %8.1f s", seconds / steps * 1e6);
  return text;
}

absl::Status PrintAgent(const Speeds& speeds, const std::string& agent) {
  v1::RunConfig config;
  config.set_agent(agent);
  CRAFTFLEET_ASSIGN_OR_RETURN(config, ResolveRunConfig(config));
  const v1::PpoConfig& ppo = config.ppo();
  const double steps = ppo.rollout_steps();
  CRAFTFLEET_ASSIGN_OR_RETURN(const Costs one, CostsOfUpdate(speeds, config, 1));
  CRAFTFLEET_ASSIGN_OR_RETURN(const Costs two, CostsOfUpdate(speeds, config, 2));
  const int minibatches = ppo.rollout_steps() / ppo.minibatch_size() * ppo.epochs();
  Costs all;
  Add(two, minibatches - 1, &all);
  Add(one, 2 - minibatches, &all);
  const int rows = (config.lanes() + 1) / 2;
  CRAFTFLEET_ASSIGN_OR_RETURN(const Costs act, CostsOfPlay(speeds, config, rows));
  Costs play;
  Add(act, steps / rows, &play);
  Add(play, 1, &all);

  const Cost sum = Sum(all);
  const Cost play_sum = Sum(play);
  absl::PrintF("%s: %.4f GFLOP and %.1f MB a step, %.4f GFLOP a sample of an update\n", agent, sum.flop / steps / 1e9,
               sum.bytes / steps / 1e6, (sum.flop - play_sum.flop) / (steps * ppo.epochs()) / 1e9);
  absl::PrintF("  %.0f computations an iteration, %.0f of them to play\n", sum.computations, play_sum.computations);
  absl::PrintF("  %-42s%s\n", "a million steps: FP32, TF32, BF16", LeastTimes(sum, steps));
  absl::PrintF("  %-42s%s\n", "of that, play", LeastTimes(play_sum, steps));
  std::vector<std::pair<std::string, Cost>> names(all.begin(), all.end());
  std::sort(names.begin(), names.end(),
            [](const auto& a, const auto& b) { return a.second.seconds > b.second.seconds; });
  names.resize(std::min(names.size(), static_cast<size_t>(std::max(0, absl::GetFlag(FLAGS_names)))));
  for (const auto& [name, cost] : names) absl::PrintF("  %-42s%s\n", name, LeastTimes(cost, steps));
  std::fflush(stdout);
  return absl::OkStatus();
}

absl::Status Run() {
  Speeds speeds;
  speeds.bytes_per_second = absl::GetFlag(FLAGS_terabytes_per_second) * 1e12;
  if (speeds.bytes_per_second <= 0) return absl::InvalidArgumentError("--terabytes_per_second: want more than 0");
  const std::vector<std::string> tflops = absl::GetFlag(FLAGS_tflops);
  for (size_t i = 0; i < kPrecisions; ++i) {
    double& speed = speeds.flop_per_second[i];
    if (tflops.size() != kPrecisions || !absl::SimpleAtod(tflops[i], &speed) || speed <= 0) {
      return absl::InvalidArgumentError(absl::StrCat("--tflops=", absl::StrJoin(tflops, ","),
                                                     ", want three numbers above 0, for FP32, TF32 and BF16"));
    }
    speed *= 1e12;
  }
  SetUpTorchThread();
  for (const std::string& agent : absl::GetFlag(FLAGS_agents)) {
    CRAFTFLEET_RETURN_IF_ERROR(PrintAgent(speeds, agent));
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(
      {craftfleet::kProgram, craftfleet::kUsage, {"agents", "tflops", "terabytes_per_second", "names"}}, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
