#include "common/wire/http_server.h"

#include <fcntl.h>
#include <microhttpd.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cstddef>

#include "common/base/mutex.h"
#include "common/base/numeric_host.h"
#include "common/base/status_macros.h"
#include "common/base/watchdog.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"
#include "common/wire/listen_socket.h"

namespace craftfleet::wire {
namespace {

constexpr char kTlsVersions[] = "NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2";  // as GnuTLS writes them

// Ends a connection that lasts longer than `timeout`, even if it is active.
class Deadline {
 public:
  Deadline(int descriptor, absl::Duration timeout)
      : timeout_(timeout), timer_(Watchdog::OfProcess(), [descriptor] { shutdown(descriptor, SHUT_RDWR); }) {
    Restart();
  }
  void Restart() { timer_.Arm(timeout_); }

 private:
  const absl::Duration timeout_;
  Watchdog::Timer timer_;
};

// Called by libmicrohttpd when a connection starts, and when it has ended but its descriptor is still open.
void OnConnection(void* timeout, MHD_Connection* connection, void** context, MHD_ConnectionNotificationCode code) {
  const int descriptor = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
  if (code == MHD_CONNECTION_NOTIFY_STARTED) {
    *context = new Deadline(descriptor, *static_cast<const absl::Duration*>(timeout));
    return;
  }
  delete static_cast<Deadline*>(*context);
  *context = nullptr;
}

// Called by libmicrohttpd when a request has been answered; the connection may go on.
void OnAnswered(void* /*server*/, MHD_Connection* connection, void** /*request*/, MHD_RequestTerminationCode /*code*/) {
  void* const context = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT)->socket_context;
  if (context != nullptr) static_cast<Deadline*>(context)->Restart();
}

MHD_Result Send(MHD_Connection* connection, bool keep_alive, const HttpServer::Response& answer) {
  MHD_Response* response =
      MHD_create_response_from_buffer(answer.body.size(), const_cast<char*>(answer.body.data()), MHD_RESPMEM_MUST_COPY);
  if (response == nullptr) return MHD_NO;
  MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_TYPE, answer.content_type.c_str());
  if (!keep_alive) MHD_add_response_header(response, MHD_HTTP_HEADER_CONNECTION, "close");
  for (const auto& [name, value] : answer.headers) {
    MHD_add_response_header(response, name.c_str(), value.c_str());
  }
  const MHD_Result queued = MHD_queue_response(connection, static_cast<unsigned>(answer.code), response);
  MHD_destroy_response(response);
  return queued;
}

std::optional<absl::string_view> Lookup(MHD_Connection* connection, MHD_ValueKind kind, const char* name) {
  const char* const value = MHD_lookup_connection_value(connection, kind, name);
  return value == nullptr ? std::nullopt : std::optional<absl::string_view>(value);
}

bool HasBody(MHD_Connection* connection) {
  return Lookup(connection, MHD_HEADER_KIND, MHD_HTTP_HEADER_CONTENT_LENGTH).has_value() ||
         Lookup(connection, MHD_HEADER_KIND, MHD_HTTP_HEADER_TRANSFER_ENCODING).has_value();
}

}  // namespace

std::optional<absl::string_view> HttpServer::Request::Header(const char* name) const {
  return Lookup(connection_, MHD_HEADER_KIND, name);
}

std::optional<absl::string_view> HttpServer::Request::Argument(const char* name) const {
  return Lookup(connection_, MHD_GET_ARGUMENT_KIND, name);
}

std::string HttpServer::Request::Client() const {
  return NumericHost(MHD_get_connection_info(connection_, MHD_CONNECTION_INFO_CLIENT_ADDRESS)->client_addr);
}

// The libmicrohttpd daemons of one listening socket. A daemon keeps the certificate that it was started with, so a new
// certificate needs a new daemon; the one before goes on serving its connections until the next change.
class HttpServer::Daemons {
 public:
  Daemons(Options options, Respond respond, std::unique_ptr<ListenSocket> socket)
      : options_(std::move(options)), respond_(std::move(respond)), socket_(std::move(socket)) {}

  // Serves new connections with this certificate and key, both empty without TLS.
  absl::Status Start(const std::string& certificate, const std::string& key) ABSL_LOCKS_EXCLUDED(mu_);
  // A file's new contents. Its certificate and key may fit only after the second of two calls.
  void Replace(bool is_key, std::string text) ABSL_LOCKS_EXCLUDED(mu_);
  // Closes the socket and ends all connections.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // A daemon that accepts no more, and its copy of the socket, which it no longer closes.
  struct Former {
    MHD_Daemon* daemon = nullptr;  // null: none
    int socket = -1;
  };

  static MHD_Result OnRequest(void* daemons, MHD_Connection* connection, const char* path, const char* method,
                              const char* version, const char* upload, size_t* upload_bytes, void** request);
  MHD_Daemon* StartDaemon(const std::string& certificate, const std::string& key) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  static void Stop(const Former& former);

  const Options options_;
  const Respond respond_;
  Mutex answering_;  // one answer at a time
  Mutex mu_;
  std::array<std::string, 2> files_ ABSL_GUARDED_BY(mu_);      // certificate, key
  std::unique_ptr<ListenSocket> socket_ ABSL_GUARDED_BY(mu_);  // null: stopped
  MHD_Daemon* current_ ABSL_GUARDED_BY(mu_) = nullptr;
  Former former_ ABSL_GUARDED_BY(mu_);
};

// Called by libmicrohttpd for each request once its headers have arrived; MHD_NO ends the connection.
MHD_Result HttpServer::Daemons::OnRequest(void* daemons, MHD_Connection* connection, const char* path,
                                          const char* method, const char* /*version*/, const char* /*upload*/,
                                          size_t* /*upload_bytes*/, void** request) {
  auto* const self = static_cast<Daemons*>(daemons);
  const absl::string_view name = method;
  const bool is_get = name == MHD_HTTP_METHOD_GET || name == MHD_HTTP_METHOD_HEAD;
  if (!is_get && !(self->options_.accept_posts && name == MHD_HTTP_METHOD_POST)) {
    return Send(
        connection, /*keep_alive=*/false,
        {MHD_HTTP_METHOD_NOT_ALLOWED, "text/plain", self->options_.accept_posts ? "want GET or POST\n" : "want GET\n"});
  }
  // An answer to the first call ends the connection, since a body may follow that nobody reads. Without one, there is
  // a second call.
  if (self->options_.keep_alive && is_get && *request == nullptr && !HasBody(connection)) {
    *request = self;
    return MHD_YES;
  }
  const MutexLock lock(&self->answering_);
  return Send(connection, self->options_.keep_alive, self->respond_(Request(connection, method, path)));
}

MHD_Daemon* HttpServer::Daemons::StartDaemon(const std::string& certificate, const std::string& key) {
  const MHD_OptionItem with_tls[] = {
      {MHD_OPTION_HTTPS_MEM_CERT, 0, const_cast<char*>(certificate.c_str())},
      {MHD_OPTION_HTTPS_MEM_KEY, 0, const_cast<char*>(key.c_str())},
      {MHD_OPTION_HTTPS_PRIORITIES, 0, const_cast<char*>(kTlsVersions)},
      {MHD_OPTION_END, 0, nullptr},
  };
  const MHD_OptionItem without_tls[] = {{MHD_OPTION_END, 0, nullptr}};
  const bool tls = !certificate.empty();
  const int copy = fcntl(socket_->descriptor(), F_DUPFD_CLOEXEC, 0);  // which the daemon closes, also if it can't start
  return MHD_start_daemon(MHD_USE_EPOLL | MHD_USE_INTERNAL_POLLING_THREAD | MHD_USE_ITC |
                              MHD_USE_SUPPRESS_DATE_NO_CLOCK | (tls ? MHD_USE_TLS : MHD_NO_FLAG),
                          0, nullptr, nullptr, &OnRequest, this, MHD_OPTION_LISTEN_SOCKET, copy,
                          MHD_OPTION_CONNECTION_LIMIT, static_cast<unsigned>(kMaxConnections),
                          MHD_OPTION_PER_IP_CONNECTION_LIMIT, static_cast<unsigned>(kMaxConnectionsPerClient),
                          MHD_OPTION_CONNECTION_MEMORY_LIMIT, kMaxRequestBytes, MHD_OPTION_NOTIFY_CONNECTION,
                          &OnConnection, const_cast<absl::Duration*>(&options_.timeout), MHD_OPTION_NOTIFY_COMPLETED,
                          &OnAnswered, nullptr, MHD_OPTION_ARRAY, tls ? with_tls : without_tls, MHD_OPTION_END);
}

absl::Status HttpServer::Daemons::Start(const std::string& certificate, const std::string& key) {
  const MutexLock lock(&mu_);
  files_ = {certificate, key};
  current_ = StartDaemon(certificate, key);
  if (current_ != nullptr) return absl::OkStatus();
  if (!certificate.empty()) {
    return absl::InvalidArgumentError("the HTTP server cannot start with this certificate and key");
  }
  return absl::ResourceExhaustedError("the HTTP server cannot start: no thread or file descriptor is left");
}

void HttpServer::Daemons::Replace(bool is_key, std::string text) {
  Former unused;
  {
    const MutexLock lock(&mu_);
    if (socket_ == nullptr) return;
    files_[is_key ? 1 : 0] = std::move(text);
    MHD_Daemon* const fresh = StartDaemon(files_[0], files_[1]);
    if (fresh == nullptr) return;
    unused = std::exchange(former_, {current_, MHD_quiesce_daemon(current_)});
    current_ = fresh;
  }
  LogInfo("the HTTP server uses the new certificate");
  Stop(unused);
}

void HttpServer::Daemons::Stop(const Former& former) {
  if (former.daemon == nullptr) return;
  MHD_stop_daemon(former.daemon);
  close(former.socket);
}

void HttpServer::Daemons::Stop() {
  const MutexLock lock(&mu_);
  socket_.reset();
  if (current_ != nullptr) MHD_stop_daemon(current_);
  Stop(former_);
}

absl::StatusOr<std::unique_ptr<HttpServer>> HttpServer::Create(const Options& options, Respond respond) {
  std::unique_ptr<HttpServer> server(new HttpServer);
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<ListenSocket> socket, ListenSocket::Create(options.address));
  server->address_ = socket->address();
  std::string certificate;
  std::string key;
  if (!options.files.certificate.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(certificate, ReadFile(options.files.certificate));
    CRAFTFLEET_ASSIGN_OR_RETURN(key, ReadFile(options.files.key));
  }
  server->daemons_ = std::make_shared<Daemons>(options, std::move(respond), std::move(socket));
  CRAFTFLEET_RETURN_IF_ERROR(server->daemons_->Start(certificate, key));
  if (!certificate.empty()) {
    const auto watch = [&server](const std::string& path, const std::string& text, bool is_key) {
      server->watches_.push_back(std::make_unique<FileWatch>(
          path, text,
          [daemons = server->daemons_, is_key](std::string now) { daemons->Replace(is_key, std::move(now)); }));
    };
    watch(options.files.certificate, certificate, /*is_key=*/false);
    watch(options.files.key, key, /*is_key=*/true);
  }
  return server;
}

HttpServer::~HttpServer() {
  if (daemons_ != nullptr) daemons_->Stop();
}

}  // namespace craftfleet::wire
