// craftfleet train: a whole run in one process.

#include <absl/flags/flag.h>

#include "common/agent/torch_setup.h"
#include "common/cpu_pin.h"
#include "common/log.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/metrics_flags.h"
#include "deploy/local_fleet.h"
#include "learner/run_flags.h"

ABSL_FLAG(std::string, listen, "",
          "address on which further actors may join and `craftfleet status` asks, HOST:PORT [none: nothing listens]");
ABSL_FLAG(
    double, env_timeout, 10,
    "seconds that a request for games may take, 0.1..3600: a step takes microseconds. One that takes longer is given "
    "up and the games go on from their snapshots");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet train";
constexpr char kUsage[] =
    R"(craftfleet train trains an agent in one process: learner, actor and environment server together, no ports.

Train PPO-CNN for 100,000 steps, then score it:
  craftfleet train --agent=ppo_cnn --env=crafter --steps=100000 --seed=1 --lanes=16 --logdir=runs/first
  craftfleet eval --checkpoint=runs/first --episodes=20

Ctrl-C stops it cleanly; the same command with --resume goes on as if it had never stopped.
Every hyperparameter is in the run's config.txt; an edited copy starts another run by --config.)";

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::MetricsServer::Options metrics_options, wire::MetricsOptionsFromFlags(""));
  CRAFTFLEET_ASSIGN_OR_RETURN(Learner::Options options, LearnerOptionsFromFlags());
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(options.config.cpu()));
  SetUpTorchThread();
  options.server.address = absl::GetFlag(FLAGS_listen);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<LocalFleet> fleet,
                              LocalFleet::Create(options, absl::Seconds(absl::GetFlag(FLAGS_env_timeout))));
  StopSignal signal([&fleet] { fleet->Stop(); });
  if (const std::string warning = SlowMathWarning(); !warning.empty()) LogWarning("%s", warning);
  Learner& learner = fleet->learner();
  LogInfo("run %s in %s%s%s", learner.run_id(), options.logdir, learner.address().empty() ? "" : "; listening on ",
          learner.address());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::MetricsServer> metrics,
                              wire::ServeMetrics(metrics_options, &learner.status()));
  CRAFTFLEET_RETURN_IF_ERROR(fleet->Run());
  LogInfo("%s", learner.trainer().finished() ? "the run is complete" : "stopped; go on with --resume");
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
