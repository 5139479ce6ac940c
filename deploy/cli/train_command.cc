// craftfleet train: trains in one process.

#include <absl/flags/flag.h>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/process/cpu_pin.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/wire/metrics.h"
#include "deploy/cli/command.h"
#include "deploy/cli/local_fleet.h"
#include "learner/run_flags.h"
#include "learner/run_messages.h"

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
  const absl::Duration env_timeout = absl::GetFlag(FLAGS_env_timeout).value;
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("env_timeout", env_timeout, absl::Milliseconds(100), absl::Hours(1)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string metrics_address, wire::MetricsAddressFromFlags(""));
  CRAFTFLEET_ASSIGN_OR_RETURN(Learner::Options options,
                              LearnerOptionsFromFlags(v1::RunConfig::CUDA, /*page_by_default=*/""));
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(options.config.cpu()));
  SetUpTorchThread();
  options.server.address = absl::GetFlag(FLAGS_listen).address.value_or("");
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<LocalFleet> fleet, LocalFleet::Create(options, env_timeout));
  StopSignal signal([&fleet] { fleet->Stop(); });
  return RunWithMessages(&fleet->learner(), options.logdir, metrics_address, [&fleet] { return fleet->Run(); });
}

int RunTrain(int argc, char** argv) {
  OutliveReaders();
  ParseFlags(
      {kProgram,
       kUsage,
       {"logdir", "agent", "env", "steps", "seed", "lanes", "resume", "config", "init_from", "listen"},
       {"run_flags.cc", "server_flags.cc", "channel_flags.cc", "metrics_flags.cc", "device", "env_timeout", "textures",
        "threads"},
       {{"env", kRunEnvHelp},
        {"seed", kRunSeedHelp},
        {"listen", "address to accept further actors, craftfleet status and craftfleet top on, HOST:PORT [none]"}}},
      argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("train", &RunTrain);

}  // namespace
}  // namespace craftfleet
