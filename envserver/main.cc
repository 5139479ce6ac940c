// craftfleet-envserver: runs Crafter games for actors.

#include <absl/flags/flag.h>

#include "common/log.h"
#include "common/paths.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "envserver/env_service.h"

ABSL_FLAG(std::string, listen, "127.0.0.1:50061",
          "address to serve actors and status on, HOST:PORT; port 0: any free one");
ABSL_FLAG(bool, insecure, false, "allow --listen beyond this host, without TLS");
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
  craftfleet status --address=127.0.0.1:50061)";

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, TextureDir(absl::GetFlag(FLAGS_textures)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<EnvServiceImpl> service, EnvServiceImpl::Create(textures));
  wire::StatusServiceImpl status("envserver", [&service](v1::StatusReply* reply) { service->FillStatus(reply); });
  const wire::Server::Options options = {absl::GetFlag(FLAGS_listen), absl::GetFlag(FLAGS_insecure)};
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::Server> server,
                              wire::Server::Create(options, {service.get(), &status}));
  StopSignal signal([&server] { server->Stop(absl::Milliseconds(500)); });
  LogInfo("listening on %s", server->address());
  server->Wait();
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
