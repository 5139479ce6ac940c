#include "common/wire/http_server.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>

#include "common/check.h"
#include "common/status_macros.h"

namespace craftfleet::wire {
namespace {

constexpr size_t kMaxRequestBytes = 8192;  // the headers of browsers and scrapers have less
constexpr int kTickMs = 250;               // between two looks at deadlines

// The listener holds a copy of the descriptor until it sees that the connection has ended.
void End(int descriptor) {
  shutdown(descriptor, SHUT_RDWR);
  close(descriptor);
}

std::string Format(const HttpServer::Response& response, bool with_body) {
  const char* reason = response.code == 200 ? "OK" : "Error";
  return absl::StrFormat("HTTP/1.1 %d %s\r\nContent-Type: %s\r\nContent-Length: %d\r\nConnection: close\r\n\r\n%s",
                         response.code, reason, response.content_type, response.body.size(),
                         with_body ? response.body : "");
}

}  // namespace

absl::StatusOr<std::unique_ptr<HttpServer>> HttpServer::Create(const std::string& address, Respond respond) {
  std::unique_ptr<HttpServer> server(new HttpServer(std::move(respond)));
  Listener::Options options;
  options.address = address;
  CRAFTFLEET_ASSIGN_OR_RETURN(server->listener_, Listener::Create(options));
  CRAFTFLEET_CHECK(pipe2(server->wake_up_, O_NONBLOCK | O_CLOEXEC) == 0);
  server->thread_ = std::thread([server = server.get()] { server->Run(); });
  server->listener_->Start([server = server.get()](int descriptor) {
    {
      const MutexLock lock(&server->mu_);
      server->new_.push_back(descriptor);
    }
    const char byte = 0;
    // A full pipe wakes just as well.
    [[maybe_unused]] const ssize_t written = write(server->wake_up_[1], &byte, 1);
  });
  return server;
}

HttpServer::~HttpServer() {
  if (!thread_.joinable()) return;
  listener_->Stop();
  close(wake_up_[1]);
  thread_.join();
  close(wake_up_[0]);
}

void HttpServer::Run() {
  bool stopping = false;
  while (!stopping) {
    std::vector<pollfd> polls = {{wake_up_[0], POLLIN, 0}};
    for (const Connection& connection : connections_) {
      const auto events = static_cast<int16_t>(connection.response.empty() ? POLLIN : POLLOUT);
      polls.push_back({connection.descriptor, events, 0});
    }
    poll(polls.data(), polls.size(), kTickMs);
    for (size_t i = connections_.size(); i-- > 0;) {
      Connection& connection = connections_[i];
      const bool goes_on = absl::Now() < connection.deadline && (polls[i + 1].revents == 0 || Serve(&connection));
      if (goes_on) continue;
      End(connection.descriptor);
      connections_.erase(connections_.begin() + static_cast<ptrdiff_t>(i));
    }
    char bytes[256];
    while (!stopping) {
      const ssize_t count = read(wake_up_[0], bytes, sizeof(bytes));
      if (count < 0) break;
      stopping = count == 0;
    }
    TakeNew();
  }
  for (const Connection& connection : connections_) End(connection.descriptor);
}

void HttpServer::TakeNew() {
  const MutexLock lock(&mu_);
  for (const int descriptor : new_) {
    if (connections_.size() >= kMaxConnections) {
      End(descriptor);
      continue;
    }
    connections_.push_back({descriptor, absl::Now() + kTimeout, "", "", 0});
  }
  new_.clear();
}

bool HttpServer::Serve(Connection* connection) {
  if (connection->response.empty()) {
    char bytes[4096];
    const ssize_t count = recv(connection->descriptor, bytes, sizeof(bytes), 0);
    if (count < 0) return errno == EAGAIN || errno == EINTR;
    if (count == 0) return false;
    connection->request.append(bytes, static_cast<size_t>(count));
    const bool whole = absl::StrContains(connection->request, "\r\n\r\n");
    if (!whole && connection->request.size() < kMaxRequestBytes) return true;
    connection->response = whole ? AnswerHttp(connection->request, respond_)
                                 : Format({431, "text/plain", "the request is too long\n"}, true);
    return true;
  }
  const ssize_t count = send(connection->descriptor, connection->response.data() + connection->sent,
                             connection->response.size() - connection->sent, MSG_NOSIGNAL);
  if (count < 0) return errno == EAGAIN || errno == EINTR;
  connection->sent += static_cast<size_t>(count);
  return connection->sent < connection->response.size();
}

std::string AnswerHttp(absl::string_view request, const HttpServer::Respond& respond) {
  const std::vector<absl::string_view> words = absl::StrSplit(request.substr(0, request.find("\r\n")), ' ');
  if (words.size() != 3 || !absl::StartsWith(words[2], "HTTP/1.")) {
    return Format({400, "text/plain", "no HTTP/1 request\n"}, true);
  }
  if (words[0] != "GET" && words[0] != "HEAD") return Format({405, "text/plain", "want GET\n"}, true);
  return Format(respond(words[1].substr(0, words[1].find('?'))), words[0] == "GET");
}

}  // namespace craftfleet::wire
