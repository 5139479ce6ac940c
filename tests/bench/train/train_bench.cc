// Measures the speed of the whole training loop in one process, and how its time is spent.

#include <sys/resource.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/paths.h"
#include "common/process/cgroup.h"
#include "common/process/program.h"
#include "common/telemetry/activity_meter.h"
#include "deploy/cli/local_fleet.h"

ABSL_FLAG(int32_t, iterations, 20, "PPO iterations to time, after one that is not counted");
ABSL_FLAG(int32_t, threads, 0, "threads; 0: as many as the CPU quota allows");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "train_bench";
constexpr char kUsage[] =
    R"(train_bench trains PPO-CNN with the paper's settings (4096-step rollouts, minibatches of 128, 4 epochs, 16 lanes) in one process and
prints environment steps per second, the shares of play (policy and games), wire (gRPC and conversion), update (PPO) and other
(advantages, logs, checkpoints, waiting), and the peak of resident memory.)";

// Seconds and steps since the start.
struct Times {
  double wall = 0;
  ByActivity trainer;
  ByActivity play;  // summed over the play threads
  int64_t steps = 0;
};

Times Read(const LocalFleet& fleet) {
  const Trainer& trainer = fleet.learner().trainer();
  v1::StatusReply actor;
  fleet.actor().FillStatus(&actor);
  Times times;
  times.wall = absl::ToDoubleSeconds(absl::Now() - absl::UnixEpoch());
  times.trainer = trainer.meter().Total().times;
  for (const v1::ActivityTime& time : actor.summary().times()) {
    times.play[*ActivityByName(time.activity())] = time.seconds();
  }
  times.steps = trainer.counters().env_steps;
  return times;
}

void Print(const Times& begin, const Times& end, int threads) {
  const double wall = end.wall - begin.wall;
  ByActivity trainer = end.trainer;
  trainer.Add(begin.trainer, -1);
  ByActivity play = end.play;
  play.Add(begin.play, -1);
  const double collect = trainer[Activity::kIntake];
  const double policy = play[Activity::kInference];
  const double games = play[Activity::kEnvironment];
  const double wire = play[Activity::kWire];
  // Play threads run concurrently: their sum is scaled to the wall time of collecting.
  const double scale = collect / (policy + games + wire);
  const double update = trainer[Activity::kUpdate];
  struct rusage usage = {};
  getrusage(RUSAGE_SELF, &usage);
  absl::PrintF("threads %d, %d steps in %.1f s\n", threads, end.steps - begin.steps, wall);
  absl::PrintF("steps/s   %8.0f\n", static_cast<double>(end.steps - begin.steps) / wall);
  absl::PrintF("play      %7.1f%%   (policy %.1f%%, games %.1f%%)\n", 100 * (policy + games) * scale / wall,
               100 * policy * scale / wall, 100 * games * scale / wall);
  absl::PrintF("wire      %7.1f%%\n", 100 * wire * scale / wall);
  absl::PrintF("update    %7.1f%%\n", 100 * update / wall);
  absl::PrintF("other     %7.1f%%\n", 100 * (wall - collect - update) / wall);
  absl::PrintF("memory    %7.0f MiB at most\n", static_cast<double>(usage.ru_maxrss) / 1024);
}

absl::Status Run() {
  SetUpTorchThread();
  Learner::Options options;
  options.config = DefaultRunConfig();
  options.config.set_steps(int64_t{4096} * (absl::GetFlag(FLAGS_iterations) + 1));
  options.threads = absl::GetFlag(FLAGS_threads) == 0 ? DefaultThreads() : absl::GetFlag(FLAGS_threads);
  CRAFTFLEET_ASSIGN_OR_RETURN(options.texture_dir, DefaultTextureDir());
  std::string folder = std::filesystem::temp_directory_path() / "train_bench_XXXXXX";
  if (mkdtemp(folder.data()) == nullptr) return absl::UnavailableError(absl::StrCat("cannot create ", folder));
  options.logdir = folder;
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<LocalFleet> fleet, LocalFleet::Create(options));
  Times begin;
  std::thread watcher([&] {
    while (fleet->learner().trainer().counters().iteration < 1) absl::SleepFor(absl::Milliseconds(5));
    begin = Read(*fleet);
  });
  const absl::Status status = fleet->Run();
  watcher.join();
  if (status.ok()) Print(begin, Read(*fleet), options.threads);
  std::filesystem::remove_all(folder);
  return status;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({craftfleet::kProgram, craftfleet::kUsage}, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
