#include "common/wire/http_server.h"

#include <microhttpd.h>
#include <sys/socket.h>

#include <cstddef>

#include "common/base/status_macros.h"
#include "common/base/watchdog.h"

namespace craftfleet::wire {
namespace {

// Ends a connection that lasts longer than kTimeout, even if it is active.
class Deadline {
 public:
  explicit Deadline(int descriptor) : timer_(Watchdog::OfProcess(), [descriptor] { shutdown(descriptor, SHUT_RDWR); }) {
    timer_.Arm(HttpServer::kTimeout);
  }

 private:
  Watchdog::Timer timer_;
};

// Called by libmicrohttpd when a connection starts, and when it has ended but its descriptor is still open.
void OnConnection(void* /*server*/, MHD_Connection* connection, void** context, MHD_ConnectionNotificationCode code) {
  const int descriptor = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
  if (code == MHD_CONNECTION_NOTIFY_STARTED) {
    *context = new Deadline(descriptor);
    return;
  }
  delete static_cast<Deadline*>(*context);
  *context = nullptr;
  // The listener counts the connection until its socket is shut down.
  shutdown(descriptor, SHUT_RDWR);
}

MHD_Result Send(MHD_Connection* connection, const HttpServer::Response& answer) {
  MHD_Response* response =
      MHD_create_response_from_buffer(answer.body.size(), const_cast<char*>(answer.body.data()), MHD_RESPMEM_MUST_COPY);
  if (response == nullptr) return MHD_NO;
  MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_TYPE, answer.content_type.c_str());
  MHD_add_response_header(response, MHD_HTTP_HEADER_CONNECTION, "close");
  const MHD_Result queued = MHD_queue_response(connection, static_cast<unsigned>(answer.code), response);
  MHD_destroy_response(response);
  return queued;
}

// Called by libmicrohttpd for each request once its headers have arrived; MHD_NO ends the connection.
MHD_Result OnRequest(void* respond, MHD_Connection* connection, const char* path, const char* method,
                     const char* /*version*/, const char* /*upload*/, size_t* /*upload_bytes*/, void** /*request*/) {
  const absl::string_view name = method;
  if (name != MHD_HTTP_METHOD_GET && name != MHD_HTTP_METHOD_HEAD) {
    return Send(connection, {MHD_HTTP_METHOD_NOT_ALLOWED, "text/plain", "want GET\n"});
  }
  return Send(connection, (*static_cast<const HttpServer::Respond*>(respond))(path));
}

}  // namespace

absl::StatusOr<std::unique_ptr<HttpServer>> HttpServer::Create(const std::string& address, Respond respond) {
  std::unique_ptr<HttpServer> server(new HttpServer(std::move(respond)));
  CRAFTFLEET_RETURN_IF_ERROR(server->Start(address));
  return server;
}

absl::Status HttpServer::Start(const std::string& address) {
  Listener::Options options;
  options.address = address;
  options.max_connections = kMaxConnections;
  options.max_connections_per_client = kMaxConnectionsPerClient;
  options.limit = "a port for HTTP";
  CRAFTFLEET_ASSIGN_OR_RETURN(listener_, Listener::Create(options));
  // libmicrohttpd's own listening socket could not be bound to both addresses of a name like localhost.
  daemon_ =
      MHD_start_daemon(MHD_USE_EPOLL | MHD_USE_INTERNAL_POLLING_THREAD | MHD_USE_ITC | MHD_USE_NO_LISTEN_SOCKET |
                           MHD_USE_SUPPRESS_DATE_NO_CLOCK,
                       0, nullptr, nullptr, &OnRequest, const_cast<Respond*>(&respond_), MHD_OPTION_CONNECTION_LIMIT,
                       static_cast<unsigned>(kMaxConnections), MHD_OPTION_PER_IP_CONNECTION_LIMIT,
                       static_cast<unsigned>(kMaxConnectionsPerClient), MHD_OPTION_CONNECTION_MEMORY_LIMIT,
                       kMaxRequestBytes, MHD_OPTION_NOTIFY_CONNECTION, &OnConnection, nullptr, MHD_OPTION_END);
  if (daemon_ == nullptr) {
    return absl::ResourceExhaustedError("the HTTP server cannot start: no thread or file descriptor is left");
  }
  listener_->Start([daemon = daemon_](int descriptor) {
    sockaddr_storage client = {};
    socklen_t size = sizeof(client);
    getpeername(descriptor, reinterpret_cast<sockaddr*>(&client), &size);
    // Takes over the descriptor, and closes it if it cannot serve it.
    MHD_add_connection(daemon, descriptor, reinterpret_cast<sockaddr*>(&client), size);
  });
  return absl::OkStatus();
}

HttpServer::~HttpServer() {
  if (daemon_ == nullptr) return;
  listener_->Stop();
  MHD_stop_daemon(daemon_);
}

}  // namespace craftfleet::wire
