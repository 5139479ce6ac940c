// craftfleet-learner: trains an agent on fragments from actors.

#include <absl/flags/flag.h>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/process/cpu_pin.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/telemetry/log.h"
#include "common/wire/metrics.h"
#include "common/wire/server.h"
#include "common/wire/wire_flags.h"
#include "learner/learner.h"
#include "learner/ranks/rank_flags.h"
#include "learner/run_flags.h"
#include "learner/run_messages.h"
#include "learner/training/distributed/rank_worker.h"

ABSL_FLAG(bool, allow_mixed, false,
          "accept workers whose numerics or game rules differ from this build's\n"
          "the result then depends on which worker plays what [such workers are refused and named in the log]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet-learner";
constexpr char kUsage[] =
    R"(craftfleet-learner trains an agent on the fragments that actors send, and serves them weights and permits.

To run a fleet on one machine, start each line in its own terminal. More actors and environment servers may join at any time:
  craftfleet-learner --agent=ppo_cnn --env=crafter --steps=1000000 --seed=1 --lanes=16 --logdir=runs/first
  craftfleet-envserver --listen=127.0.0.1:50061
  craftfleet-actor --learner=127.0.0.1:50051 --envservers=127.0.0.1:50061

Watch it:  craftfleet top --address=127.0.0.1:50051

Several learners share out the updates of a run (gradient_shards at most), each with the same flags and a --rank of its own:
  craftfleet-learner --world_size=2 --rank=0 --logdir=runs/first
  craftfleet-learner --world_size=2 --rank=1

Ctrl-C, SIGTERM or closing the terminal stops it within seconds, with a checkpoint of the last finished iteration. The same
command with --resume continues, also after a crash. Without a reader of its output (craftfleet-learner | head) it
continues silently.)";

// A stop before the run began is no error: nothing is lost.
absl::Status OkIfStopped(const absl::Status& status) {
  if (!absl::IsCancelled(status)) return status;
  LogInfo("%s", status.message());
  return absl::OkStatus();
}

// What a rank other than 0 does.
absl::Status ComputeForRank0(const RankOptions& ranks) {
  RankWorker::Options options;
  options.ranks = ranks;
  CRAFTFLEET_ASSIGN_OR_RETURN(options.threads, ThreadsFromFlags());
  options.check = [](const v1::RunConfig& config) -> absl::Status {
    CRAFTFLEET_RETURN_IF_ERROR(CheckSameAsFlags(config));
    CRAFTFLEET_RETURN_IF_ERROR(PinCpu(config.cpu()));
    SetUpTorchThread();
    return absl::OkStatus();
  };
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string metrics_address, wire::MetricsAddressFromFlags(""));
  wire::StatusServiceImpl status("rank", [](v1::StatusReply* reply) { wire::FillUsage(reply->mutable_summary()); });
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::HttpServer> metrics,
                              wire::ServeMetrics(metrics_address, &status, [] { return true; }));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<RankWorker> worker, RankWorker::Connect(options));
  const StopSignal signal([&worker] { worker->Stop(); });
  return worker->Run();
}

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const RankOptions ranks, RankOptionsFromFlags());
  if (ranks.world_size > 1) CRAFTFLEET_RETURN_IF_ERROR(CheckRankDevice());
  if (ranks.rank > 0) return OkIfStopped(ComputeForRank0(ranks));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string metrics_address, wire::MetricsAddressFromFlags(wire::kAnyFreePort));
  CRAFTFLEET_ASSIGN_OR_RETURN(Learner::Options options,
                              LearnerOptionsFromFlags(v1::RunConfig::CUDA_UPDATES, wire::kAnyFreePort));
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(options.config.cpu()));
  SetUpTorchThread();
  options.server.address = absl::GetFlag(FLAGS_listen).address.value_or(kLearnerAddress);
  options.allow_mixed = absl::GetFlag(FLAGS_allow_mixed);
  options.ranks = ranks;
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<Learner> learner, Learner::Create(options));
  StopSignal signal([&learner] { learner->Stop(); });
  return OkIfStopped(
      RunWithMessages(learner.get(), options.logdir, metrics_address, [&learner] { return learner->Run(); }));
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::OutliveReaders();
  craftfleet::ParseFlags(
      {craftfleet::kProgram,
       craftfleet::kUsage,
       {"logdir", "agent", "env", "steps", "seed", "lanes", "resume", "config", "listen", "autoresume"},
       {"learner/main.cc", "run_flags.cc", "rank_flags.cc", "server_flags.cc", "channel_flags.cc", "metrics_flags.cc",
        "device", "textures", "threads"},
       {{"env", craftfleet::kRunEnvHelp},
        {"seed", craftfleet::kRunSeedHelp},
        {"listen", "address to serve actors and status on, HOST:PORT; port 0: any free one [127.0.0.1:50051]"}}},
      argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
