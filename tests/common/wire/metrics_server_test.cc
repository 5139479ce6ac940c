#include "common/wire/metrics_server.h"

#include <arpa/inet.h>
#include <sys/socket.h>
#include <unistd.h>

#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

v1::StatusReply Status() {
  v1::StatusReply status;
  status.set_role("actor");
  return status;
}

// A TCP client of a server on 127.0.0.1.
class Client {
 public:
  explicit Client(const std::string& url) : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address = {};
    int port = 0;
    const size_t colon = url.rfind(':');
    EXPECT_TRUE(absl::SimpleAtoi(url.substr(colon + 1, url.rfind('/') - colon - 1), &port));
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  }
  ~Client() { close(socket_); }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  void Send(const std::string& bytes) { send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL); }
  // All that comes until the server ends the connection.
  std::string Receive() {
    std::string all;
    char bytes[4096];
    for (ssize_t count = 0; (count = recv(socket_, bytes, sizeof(bytes), 0)) > 0;) {
      all.append(bytes, static_cast<size_t>(count));
    }
    return all;
  }
  std::string Ask(const std::string& request) {
    Send(request);
    return Receive();
  }

 private:
  const int socket_;
};

class MetricsServerTest : public testing::Test {
 protected:
  std::string Get(const std::string& path = "/metrics") {
    return Client(server_->url()).Ask(absl::StrCat("GET ", path, " HTTP/1.1\r\nHost: a\r\n\r\n"));
  }

  std::unique_ptr<MetricsServer> server_ = *MetricsServer::Create({"127.0.0.1:0", false}, Status);
};

TEST_F(MetricsServerTest, ServesTheStatusAsText) {
  EXPECT_THAT(server_->url(), StartsWith("http://127.0.0.1:"));
  EXPECT_THAT(Get(), AllOf(StartsWith("HTTP/1.1 200 OK\r\nContent-Type: text/plain; version=0.0.4"),
                           HasSubstr("craftfleet_threads{role=\"actor\"} 0\n")));
  EXPECT_THAT(Get("/metrics?x=1"), StartsWith("HTTP/1.1 200 "));
}

TEST_F(MetricsServerTest, OtherRequestsAreAnsweredAndHarmNothing) {
  EXPECT_THAT(Get("/"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(Get("/metrics/x"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(Client(server_->url()).Ask("POST /metrics HTTP/1.1\r\nContent-Length: 0\r\n\r\n"),
              StartsWith("HTTP/1.1 405 "));
  EXPECT_THAT(Client(server_->url()).Ask("HEAD /metrics HTTP/1.0\r\n\r\n"),
              AllOf(StartsWith("HTTP/1.1 200 "), testing::EndsWith("\r\n\r\n")));
  EXPECT_THAT(Client(server_->url()).Ask("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"), StartsWith("HTTP/1.1 400 "));
  EXPECT_THAT(Client(server_->url()).Ask(std::string(100, '\0') + "\r\n\r\n"), StartsWith("HTTP/1.1 400 "));
  EXPECT_THAT(Get(), StartsWith("HTTP/1.1 200 "));
}

TEST_F(MetricsServerTest, ARequestMayComeInPieces) {
  Client client(server_->url());
  client.Send("GET /metr");
  client.Send("ics HTTP/1.1\r\n");
  EXPECT_THAT(client.Ask("\r\n"), StartsWith("HTTP/1.1 200 "));
}

TEST_F(MetricsServerTest, ARequestWithoutEndIsRefused) {
  Client client(server_->url());
  // As much as is looked at: what lies unread when the connection ends would take the answer with it.
  EXPECT_THAT(client.Ask(std::string(8192, 'x')), StartsWith("HTTP/1.1 431 "));
}

TEST_F(MetricsServerTest, SilentClientsArePutOutAndHoldNobodyUp) {
  std::vector<std::unique_ptr<Client>> silent;
  for (int i = 0; i < HttpServer::kMaxConnections - 1; ++i) silent.push_back(std::make_unique<Client>(server_->url()));
  EXPECT_THAT(Get(), StartsWith("HTTP/1.1 200 "));
  for (const auto& client : silent) EXPECT_THAT(client->Receive(), IsEmpty());
}

TEST(MetricsServer, RefusesWhatItCannotServe) {
  EXPECT_THAT(MetricsServer::Create({"0.0.0.0:0", false}, Status),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("--metrics_listen=0.0.0.0:0"), HasSubstr("--metrics_insecure"))));
  EXPECT_THAT(MetricsServer::Create({"0.0.0.0:0", true}, Status), IsOk());
  EXPECT_THAT(MetricsServer::Create({"nonsense", false}, Status),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--metrics_listen")));
  EXPECT_THAT(MetricsServer::Create({"unix:/tmp/x", false}, Status),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want HOST:PORT")));
  const auto first = MetricsServer::Create({"127.0.0.1:0", false}, Status);
  ASSERT_THAT(first, IsOk());
  const std::string url = (*first)->url();
  const std::string address = url.substr(7, url.rfind('/') - 7);
  EXPECT_THAT(MetricsServer::Create({address, false}, Status),
              StatusIs(absl::StatusCode::kUnavailable, AllOf(HasSubstr("--metrics_listen"), HasSubstr(address))));
}

}  // namespace
}  // namespace craftfleet::wire
