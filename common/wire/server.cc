#include "common/wire/server.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <map>
#include <mutex>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>
#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/impl/server_builder_option.h>
#include <grpcpp/resource_quota.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/server_builder.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"
#include "common/wire/access.h"
#include "common/wire/builtin_streams.h"
#include "common/wire/channel.h"
#include "common/wire/handshake_log.h"
#include "common/wire/protocol.h"

namespace craftfleet::wire {
namespace {

constexpr int kMaxStreamsPerConnection = 128;  // calls at once; an actor has less than ten
constexpr int kStreamsPerConnection = 4;       // in the mean, of all connections that an address may have
constexpr int kHandshakeTimeoutMs = 10'000;    // for TLS and HTTP/2's preface
constexpr int kMaxIdleMs = 300'000;            // of a connection without a call
constexpr int64_t kMaxWindowBytes = 16 << 20;  // of messages that gRPC may hold for a slow handler, and of headers
constexpr int kAcceptors = 4;                  // connections that may be handed over at once
constexpr int kMaxThreads = 4096;              // of calls without callbacks, one each; beyond: RESOURCE_EXHAUSTED

// Limits of the health port, which any client may reach: a probe sends one request and disconnects.
constexpr int kHealthConnections = 64;
constexpr int kHealthConnectionsPerClient = 16;
constexpr int kHealthStreamsPerConnection = 4;
constexpr int kHealthHandshakeMs = 5000;
constexpr int kHealthIdleMs = 10'000;
constexpr int kHealthAgeMs = 60'000;  // of a connection, even an active one; watchers reconnect
constexpr int kHealthGraceMs = 2000;
constexpr int kHealthMessageBytes = 4096;
constexpr int64_t kHealthHeaderBytes = 1 << 20;
constexpr size_t kHealthBufferedBytes = 4u << 20;

bool IsUnixSocket(absl::string_view address) { return absl::StartsWith(address, kUnix); }

// Unavailable if another process listens there: gRPC would take the name from it.
absl::Status CheckUnixSocketFree(absl::string_view flag, absl::string_view address) {
  const absl::string_view path = absl::StripPrefix(address, kUnix);
  sockaddr_un name = {};
  name.sun_family = AF_UNIX;
  path.copy(name.sun_path, sizeof(name.sun_path) - 1);
  const int socket = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (socket < 0) return FileError(errno, "cannot open a socket for", address);
  const bool taken = connect(socket, reinterpret_cast<const sockaddr*>(&name), sizeof(name)) == 0;
  close(socket);
  if (!taken) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrFormat("cannot listen on %s: another process listens there; choose another --%s", address, flag));
}

// Refuses compressed calls by their headers; data that is compressed all the same is not inflated.
void RefuseCompression(grpc::ServerBuilder* builder) {
  builder->AddChannelArgument(GRPC_COMPRESSION_CHANNEL_ENABLED_ALGORITHMS_BITSET, kNoCompression);
  builder->AddChannelArgument(GRPC_ARG_ENABLE_PER_MESSAGE_DECOMPRESSION, 0);
}

// Limits and keepalive.
void SetLimits(const Server::Options& options, grpc::ServerBuilder* builder) {
  builder->AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 5000);
  builder->AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 4000);
  builder->AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 1000);
  builder->AddChannelArgument(GRPC_ARG_HTTP2_MAX_PING_STRIKES, 0);
  builder->AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, kMaxStreamsPerConnection);
  builder->AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, kHandshakeTimeoutMs);
  builder->AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, kMaxIdleMs);
  RefuseCompression(builder);
  builder->SetMaxReceiveMessageSize(options.max_message_bytes);
  builder->SetMaxSendMessageSize(kMaxMessageBytes);
  grpc::ResourceQuota quota("craftfleet");
  quota.SetMaxThreads(kMaxThreads);
  // gRPC 1.51 checks a message's size only after receiving all of it; the quota stops a message of a gigabyte earlier.
  quota.Resize(static_cast<size_t>(options.max_buffered_mb) << 20);
  builder->SetResourceQuota(quota);
}

void SetHealthLimits(grpc::ServerBuilder* builder) {
  builder->AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 5000);
  builder->AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 4000);
  builder->AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, kHealthStreamsPerConnection);
  builder->AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, kHealthHandshakeMs);
  builder->AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, kHealthIdleMs);
  builder->AddChannelArgument(GRPC_ARG_MAX_CONNECTION_AGE_MS, kHealthAgeMs);
  builder->AddChannelArgument(GRPC_ARG_MAX_CONNECTION_AGE_GRACE_MS, kHealthGraceMs);
  RefuseCompression(builder);
  builder->SetMaxReceiveMessageSize(kHealthMessageBytes);
  grpc::ResourceQuota quota("craftfleet-health");
  quota.Resize(kHealthBufferedBytes);
  builder->SetResourceQuota(quota);
}

// Removes plugins from a builder: reflection would hold a thread for each of its streams.
class WithoutPlugins : public grpc::ServerBuilderOption {
 public:
  void UpdateArguments(grpc::ChannelArguments* /*arguments*/) override {}
  void UpdatePlugins(std::vector<std::unique_ptr<grpc::ServerBuilderPlugin>>* plugins) override { plugins->clear(); }
};

// Adds health and reflection to every builder created after this.
void InstallPlugins() {
  static std::once_flag once;
  std::call_once(once, [] {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  });
}

}  // namespace

absl::Status Server::Options::Validate() const {
  CRAFTFLEET_RETURN_IF_ERROR(files.Validate());
  const bool tls = !files.certificate.empty();
  if (!access_file.empty() && !tls) {
    return absl::InvalidArgumentError(
        "--access_file requires --tls_cert and --tls_key: without TLS no client can be authenticated");
  }
  if (max_connections_per_client < 1 || max_connections_per_client > 65536) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--max_connections_per_client=%d, want 1..65536", max_connections_per_client));
  }
  if (max_buffered_mb < 128 || max_buffered_mb > 1'000'000) {
    return absl::InvalidArgumentError(absl::StrFormat("--max_buffered_mb=%d, want 128..1000000", max_buffered_mb));
  }
  if (!health_address.empty()) CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("health_listen", health_address));
  if (address.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("listen", address));
  const bool knows_clients = (ask_clients && !files.authorities.empty()) || !access_file.empty();
  if (!insecure && tls && !knows_clients && !IsLoopback(address)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--listen=%s reaches beyond this host, where without certificates of clients anyone could "
                        "connect, with all rights: give the authority of their certificates (--tls_ca, without "
                        "--tls_client_certs=false) or their rights (--access_file), or add --insecure if the network "
                        "is trusted",
                        address));
  }
  if (!insecure && !tls && !IsLoopback(address)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--listen=%s reaches beyond this host, where anyone could connect: listen on 127.0.0.1, give a "
                        "certificate (--tls_cert, --tls_key; --tls_ca to want one of clients), or add --insecure if "
                        "the network is trusted",
                        address));
  }
  return absl::OkStatus();
}

absl::Status Server::Options::OpenAccess() {
  CRAFTFLEET_RETURN_IF_ERROR(Validate());
  if (access_file.empty()) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(access, AccessControl::Create(access_file));
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Server>> Server::Create(const Options& options,
                                                       const std::vector<grpc::Service*>& services) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  KeepGrpcUp();
  InstallPlugins();
  std::shared_ptr<grpc::ServerCredentials> credentials = grpc::InsecureServerCredentials();
  if (!options.files.certificate.empty()) {
    LogFailedHandshakes();
    credentials = TlsListenerCredentials(options.files, options.ask_clients && !options.files.authorities.empty());
  }
  if (!options.access_file.empty()) {
    Options opened = options;
    if (opened.access == nullptr) CRAFTFLEET_RETURN_IF_ERROR(opened.OpenAccess());
    credentials->SetAuthMetadataProcessor(MakeAccessProcessor(std::move(opened.access)));
  }
  std::unique_ptr<Server> server(new Server);
  CRAFTFLEET_ASSIGN_OR_RETURN(server->main_, Open(options, options.address, std::move(credentials), services));
  if (!options.health_address.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(server->health_, OpenHealth(options.health_address, &server->nothing_else_));
    LogInfo("health on %s", server->health_.address);
  }
  return server;
}

absl::StatusOr<Server::Port> Server::Open(const Options& options, const std::string& address,
                                          std::shared_ptr<grpc::ServerCredentials> credentials,
                                          const std::vector<grpc::Service*>& services) {
  Port opened;
  opened.address = address;
  grpc::ServerBuilder builder;
  int port = 1;
  if (IsUnixSocket(address)) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckUnixSocketFree("listen", address));
    builder.AddListeningPort(address, std::move(credentials), &port);
  } else if (!address.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(opened.listener, Listener::Create({address, options.max_connections_per_client}));
    opened.address = opened.listener->address();
    opened.AddAcceptors(&builder, credentials);
  }
  SetLimits(options, &builder);
  std::vector<std::unique_ptr<grpc::experimental::ServerInterceptorFactoryInterface>> interceptors;
  interceptors.push_back(LimitBuiltInStreams());
  builder.experimental().SetInterceptorCreators(std::move(interceptors));
  for (grpc::Service* service : services) builder.RegisterService(service);
  opened.server = builder.BuildAndStart();
  if (opened.server == nullptr || port == 0) {
    return absl::UnavailableError(absl::StrFormat("cannot listen on %s: choose another --listen", address));
  }
  ConnectionLimits limits;
  limits.client_streams = int64_t{kStreamsPerConnection} * options.max_connections_per_client;
  limits.unfinished_bytes = options.max_message_bytes + kMaxWindowBytes;
  limits.client_unfinished_bytes = int64_t{options.max_buffered_mb} << 20;
  if (opened.listener != nullptr) opened.Listen(limits);
  return opened;
}

absl::StatusOr<Server::Port> Server::OpenHealth(const std::string& address,
                                                grpc::CallbackGenericService* nothing_else) {
  Port opened;
  opened.address = address;
  grpc::ServerBuilder builder;
  SetHealthLimits(&builder);
  builder.SetOption(std::make_unique<WithoutPlugins>());
  // A builder needs at least one service. This one refuses all calls, on gRPC's own few threads for callback services.
  builder.RegisterCallbackGenericService(nothing_else);
  int port = 1;
  if (IsUnixSocket(address)) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckUnixSocketFree("health_listen", address));
    builder.AddListeningPort(address, grpc::InsecureServerCredentials(), &port);
  } else {
    Listener::Options listen;
    listen.address = address;
    listen.max_connections_per_client = kHealthConnectionsPerClient;
    listen.max_connections = kHealthConnections;
    listen.limit = "a health port";
    CRAFTFLEET_ASSIGN_OR_RETURN(opened.listener, Listener::Create(listen));
    opened.address = opened.listener->address();
    opened.AddAcceptors(&builder, grpc::InsecureServerCredentials());
  }
  opened.server = builder.BuildAndStart();
  if (opened.server == nullptr || port == 0) {
    return absl::UnavailableError(absl::StrFormat("cannot listen on %s: choose another --health_listen", address));
  }
  ConnectionLimits limits;
  limits.streams = 2 * kHealthStreamsPerConnection;
  limits.unfinished_bytes = kHealthMessageBytes + kHealthHeaderBytes;
  limits.client_unfinished_bytes = kHealthBufferedBytes;
  if (opened.listener != nullptr) opened.Listen(limits);
  return opened;
}

void Server::Port::AddAcceptors(grpc::ServerBuilder* builder,
                                const std::shared_ptr<grpc::ServerCredentials>& credentials) {
  // Each of them takes one connection at a time.
  for (int i = 0; i < kAcceptors; ++i) {
    acceptors.push_back(builder->experimental().AddExternalConnectionAcceptor(
        grpc::ServerBuilder::experimental_type::ExternalConnectionType::FROM_FD, credentials));
  }
}

void Server::Port::Listen(const ConnectionLimits& limits) {
  std::vector<HandOver::Handle> handles;
  for (const auto& acceptor : acceptors) {
    handles.emplace_back([acceptor = acceptor.get()](int descriptor) {
      grpc::experimental::ExternalConnectionAcceptor::NewConnectionParameters connection;
      connection.fd = descriptor;
      acceptor->HandleNewConnection(&connection);
    });
  }
  const auto watch = std::make_shared<ConnectionWatch>(limits);
  listener->Start(std::move(handles),
                  [watch](const std::map<int, std::string>& connections) { return watch->Look(connections); });
}

Server::~Server() { Stop(absl::Milliseconds(200)); }

Endpoint Server::InProcess() { return {kInProcess, main_.server->InProcessChannel(ClientArguments())}; }

void Server::Stop(absl::Duration timeout) {
  for (Port* port : {&health_, &main_}) {
    if (port->server == nullptr) continue;
    if (port->listener != nullptr) port->listener->Stop();
    port->server->Shutdown(std::chrono::system_clock::now() + absl::ToChronoMilliseconds(timeout));
    port->server->Wait();
  }
}

}  // namespace craftfleet::wire
