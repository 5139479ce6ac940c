#include "common/wire/server.h"

#include <grpc/support/log.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <mutex>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/resource_quota.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/server_builder.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"
#include "common/telemetry/limited_log.h"
#include "common/wire/access.h"
#include "common/wire/channel.h"
#include "common/wire/listen_socket.h"
#include "common/wire/protocol.h"

namespace craftfleet::wire {
namespace {

// Calls at once; an actor has up to 32 for each playing thread, further ones wait.
constexpr int kMaxStreamsPerConnection = 128;
constexpr int kHandshakeTimeoutMs = 10'000;  // for TLS and HTTP/2's preface
constexpr int kMaxIdleMs = 300'000;          // of a connection without a call
constexpr int kMaxThreads = 4096;            // of calls without callbacks, one each; beyond: RESOURCE_EXHAUSTED

bool IsUnixSocket(absl::string_view address) { return absl::StartsWith(address, kUnix); }

// Unavailable if another process listens there: gRPC would take the name from it.
absl::Status CheckUnixSocketFree(absl::string_view address) {
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
      absl::StrFormat("cannot listen on %s: another process listens there; choose another --listen", address));
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
  builder->AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);  // otherwise two servers would share a port unnoticed
  // Compressed calls are refused by their headers; data that is compressed all the same is not inflated.
  builder->AddChannelArgument(GRPC_COMPRESSION_CHANNEL_ENABLED_ALGORITHMS_BITSET, kNoCompression);
  builder->AddChannelArgument(GRPC_ARG_ENABLE_PER_MESSAGE_DECOMPRESSION, 0);
  builder->SetMaxReceiveMessageSize(options.max_message_bytes);
  builder->SetMaxSendMessageSize(kMaxMessageBytes);
  grpc::ResourceQuota quota("craftfleet");
  quota.SetMaxThreads(kMaxThreads);
  // gRPC 1.51 checks a message's size only after receiving all of it; the quota stops a message of a gigabyte earlier.
  quota.Resize(static_cast<size_t>(options.max_buffered_mb) << 20);
  builder->SetResourceQuota(quota);
}

// Called by gRPC for each of its errors, such as a failed handshake of TLS.
void OnGrpcLog(gpr_log_func_args* line) {
  static RealClock& clock = *new RealClock;  // never destroyed: gRPC's threads may outlive main
  static LimitedLog& log = *new LimitedLog(&clock);
  log.Warn(line->message, absl::StrCat("gRPC: ", line->message));
}

// Adds health to every builder created after this, and gRPC's errors to the log.
void SetUpGrpc() {
  static std::once_flag once;
  std::call_once(once, [] {
    grpc::EnableDefaultHealthCheckService(true);
    const char* const verbosity = getenv("GRPC_VERBOSITY");
    if (verbosity != nullptr && absl::string_view(verbosity) != "NONE") return;  // NONE: the programs' default
    gpr_set_log_verbosity(GPR_LOG_SEVERITY_ERROR);
    gpr_set_log_function(OnGrpcLog);
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
  if (max_buffered_mb < 128 || max_buffered_mb > 1'000'000) {
    return absl::InvalidArgumentError(absl::StrFormat("--max_buffered_mb=%d, want 128..1000000", max_buffered_mb));
  }
  if (address.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("listen", address));
  if (tls && files.authorities.empty()) {
    return absl::InvalidArgumentError(
        "--tls_cert requires --tls_ca: clients are known by certificates of this authority");
  }
  if (!insecure && !tls && !IsLoopback(address)) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "--listen=%s reaches beyond this host, where anyone could connect: listen on 127.0.0.1, use TLS "
        "(--tls_cert, --tls_key and --tls_ca), or add --insecure if the network is trusted",
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
  SetUpGrpc();
  std::shared_ptr<grpc::ServerCredentials> credentials = grpc::InsecureServerCredentials();
  if (!options.files.certificate.empty()) credentials = TlsListenerCredentials(options.files);
  if (!options.access_file.empty()) {
    Options opened = options;
    if (opened.access == nullptr) CRAFTFLEET_RETURN_IF_ERROR(opened.OpenAccess());
    credentials->SetAuthMetadataProcessor(MakeAccessProcessor(std::move(opened.access)));
  }
  std::unique_ptr<Server> server(new Server);
  CRAFTFLEET_RETURN_IF_ERROR(server->Listen(options, std::move(credentials), services));
  return server;
}

absl::Status Server::Listen(const Options& options, std::shared_ptr<grpc::ServerCredentials> credentials,
                            const std::vector<grpc::Service*>& services) {
  address_ = options.address;
  std::string listen_on = options.address;
  if (IsUnixSocket(address_)) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckUnixSocketFree(address_));
    listen_on = GrpcAddress(address_);
  } else if (!address_.empty()) {
    // gRPC doesn't say why it cannot listen.
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<ListenSocket> tried,
                                WithPrefix("--listen", ListenSocket::Create(address_)));
    address_ = tried->address();
    // Not the name, of which gRPC would take every address.
    listen_on = absl::StrCat(tried->numeric_host(), options.address.substr(options.address.rfind(':')));
  }
  grpc::ServerBuilder builder;
  int port = 1;
  if (!listen_on.empty()) builder.AddListeningPort(listen_on, std::move(credentials), &port);
  SetLimits(options, &builder);
  for (grpc::Service* service : services) builder.RegisterService(service);
  server_ = builder.BuildAndStart();
  if (server_ == nullptr || port == 0) {
    return absl::UnavailableError(absl::StrFormat("cannot listen on %s: choose another --listen", options.address));
  }
  if (!IsUnixSocket(address_) && !address_.empty()) {
    address_ = absl::StrCat(address_.substr(0, address_.rfind(':')), ":", port);
  }
  return absl::OkStatus();
}

Server::~Server() { Stop(absl::Milliseconds(200)); }

Endpoint Server::InProcess() { return {kInProcess, server_->InProcessChannel(ClientArguments())}; }

void Server::Stop(absl::Duration timeout) {
  serving_ = false;
  if (server_ == nullptr) return;  // Create failed
  server_->Shutdown(std::chrono::system_clock::now() + absl::ToChronoMilliseconds(timeout));
  server_->Wait();
}

}  // namespace craftfleet::wire
