// craftfleet-learner: trains on what actors send.

#include <iostream>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>

#include "common/agent/torch_setup.h"
#include "common/cpu_pin.h"
#include "common/log.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/metrics_flags.h"
#include "learner/learner.h"
#include "learner/run_flags.h"

ABSL_FLAG(std::string, listen, "127.0.0.1:50051",
          "address to serve actors and status on, HOST:PORT; port 0: any free one");
ABSL_FLAG(bool, allow_mixed, false,
          "let in workers that compute other numbers or play another game than this build; the result then depends on\n"
          "who plays [they are refused and named]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet-learner";
constexpr char kUsage[] =
    R"(craftfleet-learner trains an agent on the fragments that actors send, and hands out weights and work.

A fleet on one machine, each line in its own terminal; start as many actors and environment servers as you like, at any time:
  craftfleet-learner --agent=ppo_cnn --env=crafter --steps=1000000 --seed=1 --lanes=16 --logdir=runs/first
  craftfleet-envserver --listen=127.0.0.1:50061
  craftfleet-actor --learner=127.0.0.1:50051 --envservers=127.0.0.1:50061

Watch it:   craftfleet status --address=127.0.0.1:50051
Go on after a stop or a crash: the same command with --resume.)";

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::MetricsServer::Options metrics_options,
                              wire::MetricsOptionsFromFlags(wire::kAnyFreePort));
  CRAFTFLEET_ASSIGN_OR_RETURN(Learner::Options options, LearnerOptionsFromFlags());
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(options.config.cpu()));
  SetUpTorchThread();
  options.server.address = absl::GetFlag(FLAGS_listen);
  options.server.many_clients = true;
  options.allow_mixed = absl::GetFlag(FLAGS_allow_mixed);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<Learner> learner, Learner::Create(options));
  StopSignal signal([&learner] { learner->Stop(); });
  if (const std::string warning = SlowMathWarning(); !warning.empty()) LogWarning("%s", warning);
  LogInfo("run %s in %s; listening on %s", learner->run_id(), options.logdir, learner->address());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::MetricsServer> metrics,
                              wire::ServeMetrics(metrics_options, &learner->status()));
  CRAFTFLEET_RETURN_IF_ERROR(learner->Run());
  LogInfo("%s", learner->trainer().finished() ? "the run is complete" : "stopped; go on with --resume");
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
