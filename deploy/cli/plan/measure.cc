#include "deploy/cli/plan/measure.h"

#include <algorithm>
#include <cstdint>
#include <ctime>
#include <functional>
#include <limits>
#include <numeric>
#include <random>
#include <vector>

#include <absl/time/clock.h>

#include "common/agent/agent_spec.h"
#include "common/agent/initial_weights.h"
#include "common/agent/policy.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/base/crafter.h"
#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"
#include "common/process/version.h"
#include "learner/ppo/ppo_updater.h"

namespace craftfleet {
namespace {

constexpr int kEpisodeSteps = 170;  // as at the beginning of training

struct CallTime {
  double cpu_us = 0;      // of all threads, mean
  double thread_us = 0;   // CPU time of the calling thread, of the call with the least
  double elapsed_us = 0;  // of the fastest call
};

double CpuMicros(clockid_t clock) {
  timespec time = {};
  clock_gettime(clock, &time);
  return 1e6 * static_cast<double>(time.tv_sec) + 1e-3 * static_cast<double>(time.tv_nsec);
}

// Times the calls that fit into `duration`. A call that is slower than that is made once; others are made once before,
// to warm up.
absl::StatusOr<CallTime> TimeCalls(absl::Duration duration, const std::function<absl::Status()>& call) {
  constexpr double kUnknown = std::numeric_limits<double>::infinity();
  CallTime time = {0, kUnknown, kUnknown};
  const auto timed = [&] {
    const double thread = CpuMicros(CLOCK_THREAD_CPUTIME_ID);
    const absl::Time start = absl::Now();
    const absl::Status status = call();
    time.elapsed_us = std::min(time.elapsed_us, absl::ToDoubleMicroseconds(absl::Now() - start));
    time.thread_us = std::min(time.thread_us, CpuMicros(CLOCK_THREAD_CPUTIME_ID) - thread);
    return status;
  };
  double start = CpuMicros(CLOCK_PROCESS_CPUTIME_ID);
  int calls = 1;
  CRAFTFLEET_RETURN_IF_ERROR(timed());
  if (time.elapsed_us < absl::ToDoubleMicroseconds(duration)) {
    start = CpuMicros(CLOCK_PROCESS_CPUTIME_ID);
    calls = 0;
    for (const absl::Time end = absl::Now() + duration; absl::Now() < end || calls == 0; ++calls) {
      CRAFTFLEET_RETURN_IF_ERROR(timed());
    }
  }
  time.cpu_us = (CpuMicros(CLOCK_PROCESS_CPUTIME_ID) - start) / calls;
  return time;
}

std::string RandomFrames(int64_t bytes) {
  std::mt19937 random(1);
  std::string frames(bytes, '\0');
  for (char& byte : frames) byte = static_cast<char>(random());
  return frames;
}

// CPU time of choosing an action, in a full tile.
absl::StatusOr<double> MeasureActing(const v1::RunConfig& config, const AgentSpec& spec, absl::Duration duration) {
  const int tile = config.tile();
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto policy,
                              Policy::Create(spec, SaveWeights(spec, InitialWeights(spec, config.seed())), tile));
  const std::string frames = RandomFrames(tile * spec.frame_bytes());
  std::vector<int> lanes(tile);
  std::iota(lanes.begin(), lanes.end(), 0);
  const std::vector<double> noise(tile, 0.5);
  std::vector<float> states(static_cast<size_t>(tile) * spec.state_size);
  CRAFTFLEET_ASSIGN_OR_RETURN(const CallTime time, TimeCalls(duration, [&] {
                                return policy->Act(frames, lanes, noise, absl::MakeSpan(states)).status();
                              }));
  return time.cpu_us / tile;
}

// A minibatch of one lane, in fragments of the run's length. `frames` and `state` outlive it.
Rollout SampleRollout(const v1::RunConfig& config, const std::string& frames, const float* state) {
  const int steps = config.ppo().minibatch_size();
  const size_t frame_bytes = frames.size() / steps;
  Rollout rollout;
  for (int i = 0; i < steps; ++i) {
    rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&frames[i * frame_bytes]));
    rollout.actions.push_back(static_cast<Action>(i % kNumActions));
    rollout.log_probs.push_back(-2.833F);  // of 17 equally likely actions
    rollout.values.push_back(0);
    rollout.advantages.push_back(static_cast<float>(ActionNoise(1, i, 0)));
    rollout.returns.push_back(static_cast<float>(ActionNoise(1, i, 1)));
    rollout.starts.push_back(i % kEpisodeSteps == 0             ? RowStart::kEpisode
                             : i % config.fragment_steps() == 0 ? RowStart::kFragment
                                                                : RowStart::kNone);
    rollout.states.push_back(state);
  }
  return rollout;
}

// The time of one sample in one epoch.
absl::StatusOr<CallTime> MeasureUpdate(const v1::RunConfig& run, const AgentSpec& spec, int threads,
                                       const std::string& device, absl::Duration duration) {
  v1::RunConfig config = run;
  config.mutable_ppo()->set_epochs(1);
  config.clear_distillation();
  if (threads == 2) config.set_gradient_shards(2);
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto updater, PpoUpdater::Create(config, threads, device));
  const int steps = config.ppo().minibatch_size();
  const std::string frames = RandomFrames(steps * spec.frame_bytes());
  const std::vector<float> state(spec.state_size, 0.1F);
  const Rollout rollout = SampleRollout(config, frames, state.data());
  int64_t iteration = 0;
  CRAFTFLEET_ASSIGN_OR_RETURN(const CallTime time, TimeCalls(duration, [&] {
                                return updater->Update(iteration++, rollout, [] { return false; }).status();
                              }));
  return CallTime{time.cpu_us / steps, time.thread_us / steps, time.elapsed_us / steps};
}

}  // namespace

absl::StatusOr<Costs> MeasureCosts(const v1::RunConfig& config, const std::string& device, absl::Duration duration) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  const absl::Duration part = duration / 7;
  Costs costs;
  costs.cpu = CpuDescription();
  costs.build = BuildId();
  costs.config = CostlyFields(config);
  costs.measured = absl::FormatTime("%Y-%m-%d %H:%M UTC", absl::Now(), absl::UTCTimeZone());
  costs.weight_bytes = static_cast<double>(spec.param_count) * sizeof(float);

  for (const FrameFormat format : kFrameFormats) {
    CRAFTFLEET_ASSIGN_OR_RETURN(costs[format], MeasureGames(config, format, part));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(costs.act_us, MeasureActing(config, spec, part));

  CRAFTFLEET_ASSIGN_OR_RETURN(const CallTime one, MeasureUpdate(config, spec, 1, "cpu", part));
  costs.update_us = one.cpu_us;
  if (config.ppo().minibatch_size() % 2 == 0) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const CallTime two, MeasureUpdate(config, spec, 2, "cpu", part));
    // The calling thread computes one of two shards, and what is not shared out. Its CPU time does not depend on other
    // work on the machine, as elapsed time would.
    costs.two_thread_us = one.cpu_us * std::min(1.0, two.thread_us / one.thread_us);
  }
  if (device != "cpu") {
    CRAFTFLEET_ASSIGN_OR_RETURN(const CallTime gpu, MeasureUpdate(config, spec, 1, device, part));
    costs.gpu_update_us = gpu.elapsed_us;
  }
  return costs;
}

}  // namespace craftfleet
