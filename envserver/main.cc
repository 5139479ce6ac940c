// craftfleet-envserver: runs Crafter games for actors.

#include <arpa/inet.h>
#include <netinet/in.h>

#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>
#include <absl/strings/strip.h>
#include <absl/time/time.h>

#include "common/base/status_macros.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/telemetry/log.h"
#include "common/wire/channel.h"
#include "common/wire/metrics.h"
#include "common/wire/protocol.h"
#include "common/wire/status_service.h"
#include "common/wire/wire_flags.h"
#include "envserver/announcer.h"
#include "envserver/env_service.h"

ABSL_FLAG(std::string, advertise, "",
          "with --learner: the address that actors are to connect to, HOST:PORT [--listen]");

ABSL_FLAG(int32_t, max_session_games, 4096, "most games of one session, which is a thread of an actor, 1..4096");
ABSL_FLAG(int32_t, max_games, 16384, "most games of all sessions together, --max_session_games..1000000");
ABSL_FLAG(int32_t, max_session_mb, 512,
          "memory in MiB for the games of one session with their pictures, 1..1000000; more is refused");
ABSL_FLAG(int32_t, max_games_mb, 2048, "memory in MiB for the games of all sessions, --max_session_mb..1000000");
ABSL_FLAG(int32_t, max_client_percent, 50,
          "part of --max_games and --max_games_mb for all sessions of one client, in percent, 1..100\n"
          "at least the limits of one session; a client is a certificate and, without one, a host");
ABSL_FLAG(craftfleet::TimeSpan, hello_timeout, {absl::Seconds(10)},
          "how long a new session may take to send its first message, 1s..1h");
ABSL_FLAG(craftfleet::TimeSpan, idle_timeout, {absl::Minutes(10)},
          "how long a session may send no request, 1s..24h; then it ends, and its games continue elsewhere");
ABSL_FLAG(craftfleet::TimeSpan, reply_timeout, {absl::Minutes(1)},
          "how long a client may take to receive a reply, 1s..1h");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet-envserver";
constexpr char kUsage[] =
    R"(craftfleet-envserver runs Crafter games for actors. It needs no configuration: actors send the run's. Environment servers
may join and leave at any time: their games continue on another server from the last snapshot.

  craftfleet-envserver --listen=127.0.0.1:50061
  craftfleet-envserver --listen=127.0.0.1:0 --learner=127.0.0.1:50051
  craftfleet status --address=127.0.0.1:50061

Ctrl-C, SIGTERM or closing the terminal stops it.)";

constexpr char kDefaultAddress[] = "127.0.0.1:50061";
constexpr absl::Duration kMoveOut = absl::Seconds(3);  // for actors to move their games to another server

// The limits from the flags. EnvServiceImpl::Create checks whether they fit together.
absl::StatusOr<EnvServiceImpl::Options> OptionsFromFlags() {
  constexpr int32_t kMost = 1'000'000;
  EnvServiceImpl::Options options;
  options.budget.session_games = absl::GetFlag(FLAGS_max_session_games);
  options.budget.games = absl::GetFlag(FLAGS_max_games);
  options.budget.session_bytes = int64_t{absl::GetFlag(FLAGS_max_session_mb)} << 20;
  options.budget.bytes = int64_t{absl::GetFlag(FLAGS_max_games_mb)} << 20;
  options.budget.client_percent = absl::GetFlag(FLAGS_max_client_percent);
  options.hello_timeout = absl::GetFlag(FLAGS_hello_timeout).value;
  options.idle_timeout = absl::GetFlag(FLAGS_idle_timeout).value;
  options.reply_timeout = absl::GetFlag(FLAGS_reply_timeout).value;
  CRAFTFLEET_RETURN_IF_ERROR(
      CheckFlagRange("max_session_games", absl::GetFlag(FLAGS_max_session_games), 1, EnvBatch::kMaxLanes));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("max_games", absl::GetFlag(FLAGS_max_games), 1, kMost));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("max_session_mb", absl::GetFlag(FLAGS_max_session_mb), 1, kMost));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("max_games_mb", absl::GetFlag(FLAGS_max_games_mb), 1, kMost));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("hello_timeout", options.hello_timeout, absl::Seconds(1), absl::Hours(1)));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("idle_timeout", options.idle_timeout, absl::Seconds(1), absl::Hours(24)));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("reply_timeout", options.reply_timeout, absl::Seconds(1), absl::Hours(1)));
  return options;
}

std::string LearnerFromFlag() { return absl::GetFlag(FLAGS_learner).address.value_or(""); }

// Whether the host of `address` stands for all addresses of this machine.
bool IsWildcard(absl::string_view address) {
  absl::string_view part = address.substr(0, address.rfind(':'));
  if (absl::ConsumePrefix(&part, "[")) absl::ConsumeSuffix(&part, "]");
  const std::string host(part);
  in_addr four;
  in6_addr six;
  return (inet_aton(host.c_str(), &four) != 0 && four.s_addr == INADDR_ANY) ||
         (inet_pton(AF_INET6, host.c_str(), &six) == 1 && IN6_IS_ADDR_UNSPECIFIED(&six));
}

// Before anything listens.
absl::Status CheckLearnerFlags() {
  const std::string learner = LearnerFromFlag();
  const std::string advertise = absl::GetFlag(FLAGS_advertise);
  if (learner.empty()) {
    return advertise.empty() ? absl::OkStatus() : absl::InvalidArgumentError("--advertise requires --learner");
  }
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("learner", learner));
  if (!advertise.empty()) CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("advertise", advertise));
  const absl::string_view flag = advertise.empty() ? "listen" : "advertise";
  const std::string address =
      advertise.empty() ? absl::GetFlag(FLAGS_listen).address.value_or(kDefaultAddress) : advertise;
  if (IsWildcard(address)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--%s=%s is every address of this host: give the one that actors are to connect to with "
                        "--advertise=HOST:PORT",
                        flag, address));
  }
  if (wire::IsLoopback(address) && !wire::IsLoopback(learner)) {
    LogWarning(
        "--%s=%s is reached from this host only: for actors on others, --listen on an address that they reach, "
        "or give it with --advertise=HOST:PORT",
        flag, address);
  }
  return absl::OkStatus();
}

// Null without --learner.
absl::StatusOr<std::unique_ptr<Announcer>> AnnounceIfAsked(EnvServiceImpl* service, const std::string& name,
                                                           const std::string& listens_on) {
  const std::string learner = LearnerFromFlag();
  const std::string advertise = absl::GetFlag(FLAGS_advertise);
  if (learner.empty()) return nullptr;
  const std::string address = advertise.empty() ? listens_on : advertise;
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  return std::make_unique<Announcer>(
      wire::Connect(learner, security), name, address, service->texture_digest(), service->canary(),
      [service] { return service->Summary(); }, [service](const std::string& run_id) { service->SetRun(run_id); });
}

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string metrics_address, wire::MetricsAddressFromFlags(wire::kAnyFreePort));
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvServiceImpl::Options options, OptionsFromFlags());
  CRAFTFLEET_RETURN_IF_ERROR(CheckLearnerFlags());
  wire::Server::Options listen =
      wire::ServerOptionsFromFlags(absl::GetFlag(FLAGS_listen).address.value_or(kDefaultAddress));
  // Without an address no client could reach it.
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("listen", listen.address));
  listen.max_message_bytes = EnvServiceImpl::kMaxRequestBytes;
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<EnvServiceImpl> service,
                              EnvServiceImpl::Create(absl::GetFlag(FLAGS_textures), options));
  wire::StatusServiceImpl status("envserver", [&service](v1::StatusReply* reply) { service->FillStatus(reply); });
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::Server> server,
                              wire::Server::Create(listen, {service.get(), &status}));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::HttpServer> metrics,
                              wire::ServeMetrics(metrics_address, &status, [&server] { return server->serving(); }));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<Announcer> announcer,
                              AnnounceIfAsked(service.get(), status.name(), server->address()));
  StopSignal signal([&] {
    if (announcer != nullptr) {
      announcer->Leave();
      service->WaitUntilEmpty(kMoveOut);
    }
    server->Stop(absl::Milliseconds(500));
  });
  // Last, because whoever reads it may send a signal at once.
  LogInfo("listening on %s", server->address());
  server->Wait();
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::OutliveReaders();
  craftfleet::ParseFlags(
      {craftfleet::kProgram,
       craftfleet::kUsage,
       {"listen", "learner", "advertise", "textures", "max_games", "max_games_mb"},
       {"envserver/main.cc", "server_flags.cc", "channel_flags.cc", "metrics_flags.cc"},
       {{"listen", "address to serve actors and status on, HOST:PORT; port 0: any free one [127.0.0.1:50061]"},
        {"learner", "learner to register with, HOST:PORT; actors with --envservers=learner then find this server"},
        {"textures",
         "folder with Crafter's textures as PNG; the same as the learner's [the ones that come with this program]"}}},
      argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
