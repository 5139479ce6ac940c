// craftfleet-actor: plays for a learner, with games of environment servers.

#include <absl/flags/flag.h>

#include "actor/actor.h"
#include "common/agent/torch_setup.h"
#include "common/cpu_pin.h"
#include "common/cpu_quota.h"
#include "common/log.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/channel.h"
#include "common/wire/channel_flags.h"
#include "common/wire/metrics_flags.h"
#include "common/wire/server_flags.h"
#include "common/wire/status_service.h"

ABSL_FLAG(std::string, learner, "127.0.0.1:50051", "address of the learner, HOST:PORT");
ABSL_FLAG(std::string, envservers, "127.0.0.1:50061",
          "environment servers, joined by commas: HOST:PORT; dns:HOST:PORT for every address behind a name,\n"
          "looked up again every 3 s; learner for those that were started with --learner");
ABSL_FLAG(int32_t, threads, 0, "threads that play; 0: as many as the CPU quota allows");
ABSL_FLAG(int32_t, max_lanes, 4096, "games to play side by side at most; the learner gives each actor its share");
ABSL_FLAG(double, env_timeout, 10,
          "seconds that an environment server may take for a request, 0.1..3600; a step takes microseconds. One that\n"
          "opens games has a hundredth more for each. A server that takes longer is left alone until it answers again");
ABSL_FLAG(std::string, listen, "127.0.0.1:0", "address to serve status on, HOST:PORT; port 0: any free one");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet-actor";
constexpr char kUsage[] =
    R"(craftfleet-actor plays for a learner: it fetches configuration and weights from it, games from environment servers, and
sends what it played. It may come and go at any time; what it leaves unfinished another actor plays.

  craftfleet-actor --learner=127.0.0.1:50051 --envservers=127.0.0.1:50061,127.0.0.1:50062)";

absl::Status Run() {
  SetUpTorchThread();
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::MetricsServer::Options metrics_options,
                              wire::MetricsOptionsFromFlags(wire::kAnyFreePort));
  Actor::Options options;
  const std::string learner = absl::GetFlag(FLAGS_learner);
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("learner", learner));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  options.learner = wire::Connect(learner, security);
  CRAFTFLEET_ASSIGN_OR_RETURN(options.env_servers,
                              EnvDirectory::Parse("envservers", absl::GetFlag(FLAGS_envservers), security));
  options.threads = absl::GetFlag(FLAGS_threads) == 0 ? DefaultThreads() : absl::GetFlag(FLAGS_threads);
  options.capacity = absl::GetFlag(FLAGS_max_lanes);
  options.set_up = [](const v1::RunConfig& config) { return PinCpu(config.cpu()); };
  options.env_timeout = absl::Seconds(absl::GetFlag(FLAGS_env_timeout));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<Actor> actor, Actor::Create(options));
  wire::StatusServiceImpl status("actor", [&actor](v1::StatusReply* reply) { actor->FillStatus(reply); });
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::unique_ptr<wire::Server> server,
      wire::Server::Create(wire::ServerOptionsFromFlags(absl::GetFlag(FLAGS_listen)), {&status}));
  StopSignal signal([&actor] { actor->Stop(); });
  if (const std::string warning = SlowMathWarning(); !warning.empty()) LogWarning("%s", warning);
  LogInfo("status on %s", server->address());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::MetricsServer> metrics,
                              wire::ServeMetrics(metrics_options, &status));
  return actor->Run(server->address());
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  craftfleet::wire::PollFewConnections();
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
