// craftfleet-actor: plays fragments for a learner on environment servers.

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>

#include "actor/actor.h"
#include "common/agent/device.h"
#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/process/cgroup.h"
#include "common/process/cpu_pin.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/telemetry/log.h"
#include "common/wire/channel.h"
#include "common/wire/metrics.h"
#include "common/wire/protocol.h"
#include "common/wire/status_service.h"
#include "common/wire/wire_flags.h"

ABSL_FLAG(std::string, envservers, "127.0.0.1:50061",
          "environment servers, joined by commas: HOST:PORT, dns:HOST:PORT or learner\n"
          "dns: every address of a name, resolved again every 3 s; learner: the servers that registered with the\n"
          "learner (craftfleet-envserver --learner=...)");
ABSL_FLAG(std::string, frames, "scene",
          "how frames travel: raw or scene\n"
          "scene: as records of a few hundred bytes, from which this program and the learner draw the same frames.\n"
          "If either cannot draw them, frames travel raw");
ABSL_FLAG(int32_t, max_lanes, 4096,
          "maximum number of games to play side by side, 1..4096; the learner assigns each actor its share");

namespace craftfleet {
namespace {

absl::StatusOr<FrameFormat> ParseFrames(const std::string& frames) {
  if (frames == "raw") return FrameFormat::kRaw;
  if (frames == "scene") return FrameFormat::kScene;
  return InvalidFlag("frames", frames, "raw or scene");
}

constexpr char kProgram[] = "craftfleet-actor";
constexpr char kUsage[] =
    R"(craftfleet-actor plays for a learner: it fetches the configuration and weights from it, plays games of environment
servers, and sends the fragments it played. Actors may join and leave at any time: another one plays what an actor leaves
unfinished.

  craftfleet-actor --learner=127.0.0.1:50051 --envservers=127.0.0.1:50061,127.0.0.1:50062

Ctrl-C, SIGTERM or closing the terminal stops it.)";

absl::Status Run() {
  SetUpTorchThread();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string metrics_address, wire::MetricsAddressFromFlags(wire::kAnyFreePort));
  Actor::Options options;
  const std::string learner = absl::GetFlag(FLAGS_learner).address.value_or(kLearnerAddress);
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("learner", learner));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  options.learner = wire::Connect(learner, security);
  CRAFTFLEET_ASSIGN_OR_RETURN(options.env_servers,
                              EnvDirectory::Parse("envservers", absl::GetFlag(FLAGS_envservers), security));
  const int threads = absl::GetFlag(FLAGS_threads);
  if (threads < 0 || threads > 256) {
    return InvalidFlag("threads", threads, "0..256; 0: as many as the CPU quota allows");
  }
  options.threads = threads == 0 ? DefaultThreads() : threads;
  options.capacity = absl::GetFlag(FLAGS_max_lanes);
  options.find_device = [name = absl::GetFlag(FLAGS_device)](v1::RunConfig::Device run) {
    return FindActingDevice(name, run);
  };
  CRAFTFLEET_ASSIGN_OR_RETURN(options.frames, ParseFrames(absl::GetFlag(FLAGS_frames)));
  options.set_up = [](const v1::RunConfig& config) { return PinCpu(config.cpu()); };
  options.env_timeout = absl::GetFlag(FLAGS_env_timeout).value;
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<Actor> actor, Actor::Create(options));
  wire::StatusServiceImpl status("actor", [&actor](v1::StatusReply* reply) { actor->FillStatus(reply); });
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::unique_ptr<wire::Server> server,
      wire::Server::Create(
          wire::ServerOptionsFromFlags(absl::GetFlag(FLAGS_listen).address.value_or(wire::kAnyFreePort)), {&status}));
  StopSignal signal([&actor] { actor->Stop(); });
  if (const std::string warning = SlowMathWarning(); !warning.empty()) LogWarning("%s", warning);
  LogInfo("status on %s", server->address());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::HttpServer> metrics,
                              wire::ServeMetrics(metrics_address, &status, [&server] { return server->serving(); }));
  return actor->Run(server->address());
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::OutliveReaders();
  craftfleet::ParseFlags(
      {craftfleet::kProgram,
       craftfleet::kUsage,
       {"learner", "envservers", "threads", "device", "frames", "max_lanes", "env_timeout", "listen"},
       {"server_flags.cc", "channel_flags.cc", "metrics_flags.cc"},
       {{"learner", "address of the learner, HOST:PORT [127.0.0.1:50051]"},
        {"threads", "playing threads; 0: as many as the CPU quota allows"},
        {"device",
         "device to act on: auto (what the run acts on), cpu, cuda or cuda:N\n"
         "a run acts on GPUs if its configuration has device: CUDA; at most two threads play then"},
        {"env_timeout",
         "how long an environment server may take for a request, 0.1s..1h; a step takes microseconds\n"
         "A request that opens games has 1% more time for each game. A server that takes longer is not used\n"
         "until it answers again"},
        {"listen", "address to serve status on, HOST:PORT; port 0: any free one [127.0.0.1:0]"}}},
      argc, argv);
  craftfleet::wire::PollFewConnections();
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
