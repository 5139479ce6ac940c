#include "common/wire/server.h"

#include <arpa/inet.h>

#include <chrono>
#include <mutex>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/server_builder.h>

#include "common/status_macros.h"
#include "common/wire/protocol.h"

namespace craftfleet::wire {
namespace {

bool IsUnixSocket(absl::string_view address) { return absl::StartsWith(address, "unix:"); }

bool IsLoopback(absl::string_view address) {
  if (IsUnixSocket(address)) return true;
  const std::string host(address.substr(0, address.rfind(':')));
  in_addr number{};
  const bool in_127 = inet_pton(AF_INET, host.c_str(), &number) == 1 && (ntohl(number.s_addr) >> 24) == 127;
  return in_127 || host == "localhost" || host == "[::1]";
}

// Health and reflection hook into every builder made after this.
void InstallPlugins() {
  static std::once_flag once;
  std::call_once(once, [] {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  });
}

}  // namespace

absl::Status Server::Options::Validate() const {
  if (address.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("listen", address));
  if (!insecure && !IsLoopback(address)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--listen=%s reaches beyond this host, where anyone could connect: listen on 127.0.0.1, or add "
                        "--insecure if the network is trusted",
                        address));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Server>> Server::Create(const Options& options,
                                                       const std::vector<grpc::Service*>& services) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  KeepGrpcUp();
  InstallPlugins();
  grpc::ServerBuilder builder;
  int port = 0;
  if (!options.address.empty()) {
    builder.AddListeningPort(options.address, grpc::InsecureServerCredentials(), &port);
  }
  // Without this two servers could share a port and split its clients between them.
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 5000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 4000);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 1000);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MAX_PING_STRIKES, 0);
  builder.SetMaxReceiveMessageSize(kMaxMessageBytes);
  builder.SetMaxSendMessageSize(kMaxMessageBytes);
  for (grpc::Service* service : services) builder.RegisterService(service);
  std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  const bool bound = options.address.empty() || port != 0;
  if (server == nullptr || !bound) {
    return absl::UnavailableError(absl::StrFormat(
        "cannot listen on %s: the port is in use, or the host is not this machine; choose another --listen",
        options.address));
  }
  std::string address = options.address;
  // For a socket's path `port` is 1.
  if (port != 0 && !IsUnixSocket(address))
    address = absl::StrCat(absl::string_view(address).substr(0, address.rfind(':')), ":", port);
  return std::unique_ptr<Server>(new Server(std::move(server), std::move(address)));
}

Server::Server(std::unique_ptr<grpc::Server> server, std::string address)
    : server_(std::move(server)), address_(std::move(address)) {}

Server::~Server() { Stop(absl::Milliseconds(200)); }

Endpoint Server::InProcess() { return {kInProcess, server_->InProcessChannel(ClientArguments())}; }

void Server::Stop(absl::Duration timeout) {
  server_->Shutdown(std::chrono::system_clock::now() + absl::ToChronoMilliseconds(timeout));
  server_->Wait();
}

}  // namespace craftfleet::wire
