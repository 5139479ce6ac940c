// craftfleet train: trains in one process.

#include <absl/flags/flag.h>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/process/cpu_pin.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/telemetry/log.h"
#include "common/wire/metrics_flags.h"
#include "deploy/cli/local_fleet.h"
#include "learner/run_flags.h"
#include "learner/run_messages.h"

ABSL_FLAG(std::string, listen, "",
          "address to accept further actors, craftfleet status and craftfleet top on, HOST:PORT [none]");
ABSL_FLAG(craftfleet::TimeSpan, env_timeout, {absl::Seconds(10)},
          "time limit of a request for game steps, 0.1s..1h; a step takes microseconds\n"
          "after that the request is abandoned, and the games continue from their snapshots");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet train";
constexpr char kUsage[] =
    R"(craftfleet train trains an agent in one process, which contains a learner, an actor and an environment server.

Train PPO-CNN for 100,000 steps, then score it:
  craftfleet train --agent=ppo_cnn --env=crafter --steps=100000 --seed=1 --lanes=16 --logdir=runs/first
  craftfleet eval --checkpoint=runs/first --episodes=20

Ctrl-C, SIGTERM or closing the terminal stops it within seconds, with a checkpoint of the last finished iteration. The same
command with --resume continues the run as if it had never stopped. If its output is closed (craftfleet train | head), it
continues silently. The run's config.txt has every hyperparameter; --config starts another run with an edited copy.)";

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::MetricsServer::Options metrics_options, wire::MetricsOptionsFromFlags(""));
  CRAFTFLEET_ASSIGN_OR_RETURN(Learner::Options options,
                              LearnerOptionsFromFlags(v1::RunConfig::CUDA, /*page_by_default=*/""));
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(options.config.cpu()));
  SetUpTorchThread();
  options.server.address = absl::GetFlag(FLAGS_listen);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<LocalFleet> fleet,
                              LocalFleet::Create(options, absl::GetFlag(FLAGS_env_timeout).value));
  StopSignal signal([&fleet] { fleet->Stop(); });
  if (const std::string warning = SlowMathWarning(); !warning.empty()) LogWarning("%s", warning);
  Learner& learner = fleet->learner();
  CRAFTFLEET_RETURN_IF_ERROR(LogRunStart(learner, options.logdir));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::MetricsServer> metrics,
                              wire::ServeMetrics(metrics_options, &learner.status()));
  CRAFTFLEET_RETURN_IF_ERROR(fleet->Run());
  LogRunEnd(learner);
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::OutliveReaders();
  craftfleet::ParseFlags(
      craftfleet::kProgram, craftfleet::kUsage, argc, argv,
      {"logdir", "agent", "env", "steps", "seed", "lanes", "resume", "config", "init_from", "listen"});
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
