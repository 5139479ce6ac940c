// craftfleet-envserver: runs Crafter games for actors.

#include <absl/flags/flag.h>

#include "common/log.h"
#include "common/paths.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "common/texture_digest.h"
#include "common/wire/channel.h"
#include "common/wire/channel_flags.h"
#include "common/wire/metrics_flags.h"
#include "common/wire/server_flags.h"
#include "common/wire/status_service.h"
#include "envserver/announcer.h"
#include "envserver/env_service.h"

ABSL_FLAG(std::string, listen, "127.0.0.1:50061",
          "address to serve actors and status on, HOST:PORT; port 0: any free one");
ABSL_FLAG(std::string, learner, "",
          "address of a learner to register with, so that actors with --envservers=learner find this server");
ABSL_FLAG(std::string, advertise, "", "with --learner: the address that actors are told, HOST:PORT [--listen]");
ABSL_FLAG(std::string, textures, "",
          "folder with Crafter's textures as PNG; must be the same as the learner's\n"
          "[the ones that come with this program]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet-envserver";
constexpr char kUsage[] =
    R"(craftfleet-envserver runs Crafter games for actors. It needs no configuration: actors bring the run's.
It may come and go at any time; games that it held go on elsewhere from their last snapshot.

  craftfleet-envserver --listen=127.0.0.1:50061
  craftfleet-envserver --listen=127.0.0.1:0 --learner=127.0.0.1:50051
  craftfleet status --address=127.0.0.1:50061)";

constexpr absl::Duration kMoveOut = absl::Seconds(3);  // for actors to move their games

// Null without --learner.
absl::StatusOr<std::unique_ptr<Announcer>> AnnounceIfAsked(const EnvServiceImpl& service, const std::string& listens_on,
                                                           const std::string& textures) {
  const std::string learner = absl::GetFlag(FLAGS_learner);
  const std::string advertise = absl::GetFlag(FLAGS_advertise);
  if (learner.empty()) {
    if (advertise.empty()) return nullptr;
    return absl::InvalidArgumentError("--advertise wants --learner beside it");
  }
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("learner", learner));
  const std::string address = advertise.empty() ? listens_on : advertise;
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("advertise", address));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string digest, TextureDigest(textures));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  return std::make_unique<Announcer>(wire::Connect(learner, security), address, digest,
                                     [&service] { return service.Summary(); });
}

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::MetricsServer::Options metrics_options,
                              wire::MetricsOptionsFromFlags(wire::kAnyFreePort));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, TextureDir(absl::GetFlag(FLAGS_textures)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<EnvServiceImpl> service, EnvServiceImpl::Create(textures));
  wire::StatusServiceImpl status("envserver", [&service](v1::StatusReply* reply) { service->FillStatus(reply); });
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::unique_ptr<wire::Server> server,
      wire::Server::Create(wire::ServerOptionsFromFlags(absl::GetFlag(FLAGS_listen)), {service.get(), &status}));
  LogInfo("listening on %s", server->address());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::MetricsServer> metrics,
                              wire::ServeMetrics(metrics_options, &status));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<Announcer> announcer,
                              AnnounceIfAsked(*service, server->address(), textures));
  StopSignal signal([&] {
    if (announcer != nullptr) {
      announcer->Leave();
      service->WaitUntilEmpty(kMoveOut);
    }
    server->Stop(absl::Milliseconds(500));
  });
  server->Wait();
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  craftfleet::wire::PollFewConnections();
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
