// Times of acting and learning: one inference tile, one minibatch and a whole PPO update, beside the speed at which
// the CPU multiplies matrices.
// Usage: update_bench [seconds a figure, default 2 [AGENT[:PRECISION]...]], as in ppo_spcnn:BF16
// As on a CPU without AVX-512: ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2 update_bench ...

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "common/agent/initial_weights.h"
#include "common/agent/policy.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/base/cpu_path.h"
#include "common/base/keyed_random.h"
#include "common/base/worker_pool.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

constexpr int kMinibatch = 128;
constexpr int kSteps = 2 * kMinibatch;  // of a rollout

struct Times {
  double wall_ms;
  double cpu_ms;  // of all threads: the more reliable figure on a busy machine
};

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

// Medians over the calls that fit into `limit`, at least one, after a warm-up call.
Times Measure(absl::Duration limit, const std::function<void()>& call) {
  call();
  std::vector<double> wall_ms;
  std::vector<double> cpu_ms;
  for (const absl::Time end = absl::Now() + limit; absl::Now() < end || wall_ms.empty();) {
    const absl::Time start = absl::Now();
    const std::clock_t cpu_start = std::clock();
    call();
    cpu_ms.push_back(1e3 * static_cast<double>(std::clock() - cpu_start) / CLOCKS_PER_SEC);
    wall_ms.push_back(absl::ToDoubleMilliseconds(absl::Now() - start));
  }
  return {Median(wall_ms), Median(cpu_ms)};
}

// One product on each thread.
void BenchProducts(absl::Duration limit) {
  constexpr int kSize = 2048;
  const at::Tensor factor = at::ones({kSize, kSize});
  for (const int threads : {1, 2}) {
    WorkerPool workers(threads, SetUpTorchThread);
    const Times times = Measure(limit, [&] { workers.Run(threads, [&](int) { (void)at::mm(factor, factor); }); });
    std::printf("products of matrices of %d x %d, %d thread(s): %.0f GFLOP/s\n", kSize, kSize, threads,
                threads * 2.0 * kSize * kSize * kSize / times.wall_ms / 1e6);
  }
}

void BenchTiles(absl::Duration limit) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  const std::string weights = SaveWeights(spec, InitialWeights(spec, 1));
  for (const int tile : {1, 8, 16, 64}) {
    const auto policy = *Policy::Create(spec, weights, tile);
    const std::string frames = GoldenFrames(1, tile, spec.frame_size);
    std::vector<int> lanes(tile);
    std::iota(lanes.begin(), lanes.end(), 0);
    const std::vector<double> noise(tile, 0.5);
    const Times times = Measure(limit, [&] { (void)policy->Act(frames, lanes, noise, {}); });
    std::printf("act, tile of %2d: %.3f ms (CPU %.3f), %.0f frames/s of CPU\n", tile, times.wall_ms, times.cpu_ms,
                tile / times.cpu_ms * 1e3);
  }
}

// Steps of 16 lanes in fragments of 32; episodes take 170 steps, as at the beginning of training.
Rollout SampleRollout(const std::string& frames, const float* state) {
  const size_t frame_bytes = frames.size() / kSteps;
  Rollout rollout;
  for (int i = 0; i < kSteps; ++i) {
    rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&frames[i * frame_bytes]));
    rollout.actions.push_back(static_cast<Action>(i % kNumActions));
    rollout.log_probs.push_back(-2.833F);
    rollout.values.push_back(0);
    rollout.advantages.push_back(static_cast<float>(ActionNoise(1, i, 0)));
    rollout.returns.push_back(static_cast<float>(ActionNoise(1, i, 1)));
    rollout.starts.push_back(i % 170 == 0 ? RowStart::kEpisode : i % 32 == 0 ? RowStart::kFragment : RowStart::kNone);
    rollout.states.push_back(state);
  }
  return rollout;
}

// `name`: AGENT[:PRECISION].
void BenchUpdate(absl::Duration limit, const std::string& name) {
  const std::pair<std::string, std::string> parts = absl::StrSplit(name, absl::MaxSplits(':', 1));
  const std::string& agent = parts.first;
  v1::RunConfig::Precision precision = v1::RunConfig::FP32;
  if (!parts.second.empty() && !v1::RunConfig::Precision_Parse(parts.second, &precision)) {
    std::printf("%s: want FP32 or BF16 behind the colon\n", name.c_str());
    return;
  }
  v1::RunConfig config;
  config.set_agent(agent);
  config.set_precision(precision);
  config.set_gradient_shards(2);
  v1::PpoConfig* ppo = config.mutable_ppo();
  ppo->set_minibatch_size(kMinibatch);
  ppo->set_epochs(1);
  ppo->set_learning_rate(3e-4);
  ppo->set_clip(0.2);
  ppo->set_value_coefficient(0.5);
  ppo->set_max_gradient_norm(0.5);
  ppo->set_adam_epsilon(1e-5);
  const absl::StatusOr<AgentSpec> spec = FindAgent(agent);
  if (!spec.ok()) {
    std::printf("%s\n", std::string(spec.status().message()).c_str());
    return;
  }
  const std::string frames = GoldenFrames(1, kSteps, spec->frame_size);
  const std::vector<float> state(spec->state_size, 0.1F);
  const Rollout rollout = SampleRollout(frames, state.data());
  for (const int threads : {1, 2}) {
    const auto created = PpoUpdater::Create(config, threads);
    if (!created.ok()) {
      std::printf("%s: %s\n", name.c_str(), std::string(created.status().message()).c_str());
      return;
    }
    PpoUpdater* const updater = created->get();
    int64_t iteration = 0;
    const Times times = Measure(limit, [&] { (void)updater->Update(iteration++, rollout, [] { return false; }); });
    constexpr int kMinibatches = kSteps / kMinibatch;
    std::printf(
        "%s update, minibatch of %d, %d thread(s): %.2f ms (CPU %.2f), %.1f samples/s of CPU; 4096 steps x 4 epochs: "
        "%.2f s\n",
        name.c_str(), kMinibatch, threads, times.wall_ms / kMinibatches, times.cpu_ms / kMinibatches,
        kSteps / times.cpu_ms * 1e3, times.wall_ms / kMinibatches * 4096 * 4 / kMinibatch / 1e3);
  }
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::SetUpTorchThread();
  const char* const capability = std::getenv("ATEN_CPU_CAPABILITY");
  std::optional<craftfleet::ScopedCpuPath> path;
  if (capability != nullptr && std::string(capability) == "avx2") path.emplace(craftfleet::CpuPath::kAvx2);
  const absl::Duration limit = absl::Seconds(argc > 1 ? std::atof(argv[1]) : 2);
  std::printf("%s\n%s", craftfleet::CpuDescription().c_str(), craftfleet::SlowMathWarning().c_str());
  craftfleet::BenchProducts(limit);
  if (argc > 2) {
    for (int i = 2; i < argc; ++i) craftfleet::BenchUpdate(limit, argv[i]);
    return 0;
  }
  craftfleet::BenchTiles(limit);
  for (const char* agent : {"ppo_cnn", "lstm_cnn"}) craftfleet::BenchUpdate(limit, agent);
  return 0;
}
