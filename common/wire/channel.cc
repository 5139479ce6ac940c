#include "common/wire/channel.h"

#include <arpa/inet.h>
#include <errno.h>
#include <grpc/grpc.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <mutex>

#include <absl/status/status.h>
#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>
#include <grpcpp/completion_queue.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/security/credentials.h>

#include "common/base/need_threads.h"
#include "common/base/status_macros.h"
#include "common/wire/certificates.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"

namespace craftfleet::wire {

namespace {

constexpr int kGrpcThreads = 12;  // that a server of gRPC 1.51 starts at once; it aborts or hangs without them

// The user agent, which peers log: "craftfleet-actor@host/1234".
std::string UserAgent() {
  char host[256] = "?";
  gethostname(host, sizeof(host) - 1);
  return absl::StrCat(program_invocation_short_name, "@", host, "/", getpid());
}

// Why a channel failed to connect: a call without wait_for_ready returns the reason at once.
std::string ConnectionProblem(const Endpoint& endpoint) {
  constexpr char kNoAnswer[] = "nothing listens there, the host is unknown or it does not answer";
  grpc::ClientContext context;
  SetDeadline(&context, absl::Milliseconds(200));
  grpc::CompletionQueue queue;
  const grpc::ByteBuffer nothing;
  grpc::ByteBuffer reply;
  grpc::Status status;
  const auto call =
      grpc::GenericStub(endpoint.channel).PrepareUnaryCall(&context, "/grpc.health.v1.Health/Check", nothing, &queue);
  call->StartCall();
  call->Finish(&reply, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  const absl::Status error = FromGrpc(status, "");
  const absl::Status explained = endpoint.security.Explain(error, endpoint.address);
  return explained == error ? kNoAnswer : std::string(explained.message());
}

}  // namespace

void KeepGrpcUp() {
  KeepOpenSslUp();
  static std::once_flag once;
  std::call_once(once, [] {
    NeedThreads(kGrpcThreads);
    grpc_init();
  });
}

void PollFewConnections() {
  // When descriptors run out, gRPC's poll(2) engine corrupts memory; the default engine does not.
  rlimit limit = {};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur < kPlentyOfFiles) return;
  setenv("GRPC_POLL_STRATEGY", "poll", /*overwrite=*/0);
  // A connection without a waiting call is polled only by a timer, by default every 5 s: too late for keepalive. The
  // handshake of TLS takes several polls, and must be over before the time for an attempt to connect (ClientArguments).
  setenv("GRPC_CLIENT_CHANNEL_BACKUP_POLL_INTERVAL_MS", "100", /*overwrite=*/0);
}

grpc::ChannelArguments ClientArguments() {
  grpc::ChannelArguments arguments;
  arguments.SetUserAgentPrefix(UserAgent());
  arguments.SetMaxReceiveMessageSize(kMaxMessageBytes);
  arguments.SetMaxSendMessageSize(kMaxMessageBytes);
  arguments.SetInt(GRPC_COMPRESSION_CHANNEL_ENABLED_ALGORITHMS_BITSET, kNoCompression);
  arguments.SetInt(GRPC_ARG_ENABLE_PER_MESSAGE_DECOMPRESSION, 0);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 5000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 4000);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 200);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 1000);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 2000);
  // The proxy of http_proxy is one for web pages: it reaches no process of a fleet.
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  // Separate channels to one server (one per thread) must not share a connection.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  return arguments;
}

Endpoint Connect(absl::string_view address, const ChannelSecurity& security) {
  KeepGrpcUp();
  grpc::ChannelArguments arguments = ClientArguments();
  if (!security.server_name().empty()) arguments.SetSslTargetNameOverride(security.server_name());
  return {std::string(address), grpc::CreateCustomChannel(GrpcAddress(address), security.Credentials(), arguments),
          security};
}

Endpoint ConnectApart(const Endpoint& peer) {
  return peer.address == kInProcess ? peer : Connect(peer.address, peer.security);
}

std::string GrpcAddress(absl::string_view address) {
  absl::string_view path = address;
  if (!absl::ConsumePrefix(&path, kUnix)) return std::string(address);
  std::string uri(kUnix);
  for (const char c : path) {
    if (absl::ascii_isalnum(c) || absl::StrContains("/-._~", c)) {
      uri.push_back(c);
    } else {
      absl::StrAppendFormat(&uri, "%%%02X", static_cast<unsigned char>(c));
    }
  }
  return uri;
}

absl::Status CheckAddress(absl::string_view flag, absl::string_view address) {
  const auto error = [&](absl::string_view want) {
    return absl::InvalidArgumentError(absl::StrFormat("--%s: \"%s\" is not an address, want %s", flag, address, want));
  };
  absl::string_view path = address;
  if (absl::ConsumePrefix(&path, kUnix) && !path.empty()) {
    if (absl::StrContains(path, ',')) return error("a path without commas, at which gRPC divides it");
    if (path.size() < sizeof(sockaddr_un::sun_path)) return absl::OkStatus();
    return error(absl::StrCat("a path of at most ", sizeof(sockaddr_un::sun_path) - 1,
                              " bytes, as Unix sockets have; give a shorter folder"));
  }
  const size_t scheme = address.find("://");
  if (scheme != absl::string_view::npos) {
    return error(absl::StrCat("HOST:PORT or unix:PATH, without ", address.substr(0, scheme + 3)));
  }
  const size_t colon = address.rfind(':');
  const absl::string_view host = address.substr(0, colon);
  const absl::string_view number = colon == absl::string_view::npos ? "" : address.substr(colon + 1);
  int port = -1;
  if (host.empty() || !std::all_of(number.begin(), number.end(), absl::ascii_isdigit) ||
      !absl::SimpleAtoi(number, &port) || port > 65535 || host.find_first_of(" \t/") != absl::string_view::npos) {
    return error("HOST:PORT or unix:PATH");
  }
  if (absl::StrContains(host, ':') && !(absl::StartsWith(host, "[") && absl::EndsWith(host, "]"))) {
    return error("an IPv6 address in brackets, such as [::1]:50051");
  }
  return absl::OkStatus();
}

bool IsLoopback(absl::string_view address) {
  if (absl::StartsWith(address, kUnix)) return true;
  const std::string host(address.substr(0, address.rfind(':')));
  in_addr number{};
  const bool in_127 = inet_pton(AF_INET, host.c_str(), &number) == 1 && (ntohl(number.s_addr) >> 24) == 127;
  return in_127 || host == "localhost" || host == "[::1]";
}

absl::Status FromCall(const grpc::Status& status, absl::string_view who, const Endpoint& endpoint) {
  if (status.ok()) return absl::OkStatus();
  const absl::Status explained = endpoint.security.Explain(FromGrpc(status, ""), endpoint.address);
  return {explained.code(), absl::StrCat(who, ": ", absl::StripPrefix(explained.message(), ": "))};
}

absl::Status WaitUntilConnected(absl::string_view who, const Endpoint& endpoint, absl::Duration timeout) {
  if (endpoint.address == kInProcess) return absl::OkStatus();  // always connected; has no state to ask for
  const auto deadline = std::chrono::system_clock::now() + absl::ToChronoMilliseconds(timeout);
  while (true) {
    const grpc_connectivity_state state = endpoint.channel->GetState(/*try_to_connect=*/true);
    if (state == GRPC_CHANNEL_READY) return absl::OkStatus();
    if (state == GRPC_CHANNEL_TRANSIENT_FAILURE) {
      return absl::UnavailableError(
          absl::StrFormat("%s %s: cannot connect: %s", who, endpoint.address, ConnectionProblem(endpoint)));
    }
    if (!endpoint.channel->WaitForStateChange(state, deadline)) {
      return absl::UnavailableError(
          absl::StrFormat("%s %s: no answer within %s", who, endpoint.address, absl::FormatDuration(timeout)));
    }
  }
}

void SetDeadline(grpc::ClientContext* context, absl::Duration timeout) {
  context->set_deadline(std::chrono::system_clock::now() + absl::ToChronoMilliseconds(timeout));
}

}  // namespace craftfleet::wire
