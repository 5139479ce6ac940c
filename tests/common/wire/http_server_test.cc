#include "common/wire/http_server.h"

#include <microhttpd.h>

#include <atomic>
#include <ctime>
#include <random>
#include <thread>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/metrics.h"
#include "tests/fakes/http_client.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::AnyOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

// An error with this status. From version 1.0 on, libmicrohttpd closes the connection of what is no HTTP without one.
testing::Matcher<std::string> IsRefused(const std::string& status) {
  const testing::Matcher<std::string> error = StartsWith(absl::StrCat("HTTP/1.1 ", status, " "));
  if (MHD_VERSION < 0x01000000) return error;
  return AnyOf(IsEmpty(), error);
}

class ServeMetricsTest : public testing::Test {
 protected:
  std::string Get(const std::string& path = "/metrics", const char* from = "127.0.0.1") {
    return HttpClient(server_->address(), from).Ask(absl::StrCat("GET ", path, " HTTP/1.1\r\nHost: a\r\n\r\n"));
  }

  std::atomic<bool> serving_{true};
  StatusServiceImpl status_{"actor", [](v1::StatusReply* /*reply*/) {}};
  std::unique_ptr<HttpServer> server_ = *ServeMetrics(kAnyFreePort, &status_, [this] { return serving_.load(); });
};

TEST_F(ServeMetricsTest, ServesTheStatusAsText) {
  EXPECT_THAT(server_->address(), StartsWith("127.0.0.1:"));
  EXPECT_EQ(status_.Snapshot().metrics_address(), absl::StrCat("http://", server_->address(), "/metrics"));
  EXPECT_THAT(Get(),
              AllOf(StartsWith("HTTP/1.1 200 OK\r\n"), HasSubstr("\r\nContent-Type: text/plain; version=0.0.4"),
                    HasSubstr("\r\nConnection: close\r\n"), HasSubstr("craftfleet_threads{role=\"actor\"} 0\n")));
  EXPECT_THAT(Get("/metrics?x=1"), StartsWith("HTTP/1.1 200 "));
}

// The request of Kubernetes' probes.
TEST_F(ServeMetricsTest, TellsWhetherTheProcessServes) {
  EXPECT_THAT(Get("/healthz"), StartsWith("HTTP/1.1 200 "));
  serving_ = false;
  EXPECT_THAT(Get("/healthz"), StartsWith("HTTP/1.1 503 "));
  EXPECT_THAT(Get(), StartsWith("HTTP/1.1 200 "));
}

TEST_F(ServeMetricsTest, AnswersOtherRequestsWithErrors) {
  EXPECT_THAT(Get("/"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(Get("/metrics/x"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(HttpClient(server_->address()).Ask("POST /metrics HTTP/1.1\r\nHost: a\r\nContent-Length: 0\r\n\r\n"),
              StartsWith("HTTP/1.1 405 "));
  EXPECT_THAT(HttpClient(server_->address()).Ask("HEAD /metrics HTTP/1.0\r\n\r\n"),
              AllOf(StartsWith("HTTP/1.1 200 "), testing::EndsWith("\r\n\r\n")));
  EXPECT_THAT(HttpClient(server_->address()).Ask("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"), StartsWith("HTTP/1.1 505 "));
  EXPECT_THAT(HttpClient(server_->address()).Ask("\x16\x03\x01 TLS?\r\n\r\n"), IsRefused("400"));
  EXPECT_THAT(Get(), StartsWith("HTTP/1.1 200 "));
}

TEST_F(ServeMetricsTest, ARequestMayComeInPieces) {
  HttpClient client(server_->address());
  client.Send("GET /metr");
  client.Send("ics HTTP/1.1\r\nHost: a\r\n");
  EXPECT_THAT(client.Ask("\r\n"), StartsWith("HTTP/1.1 200 "));
}

TEST_F(ServeMetricsTest, OverlongRequestsAreRefused) {
  // Exactly as much as the server reads: closing with unread bytes would discard the answer.
  const std::string head = "GET /metrics HTTP/1.1\r\nHost: a\r\n";
  EXPECT_THAT(HttpClient(server_->address()).Ask(head + std::string(HttpServer::kMaxRequestBytes - head.size(), 'x')),
              StartsWith("HTTP/1.1 431 "));
  EXPECT_THAT(HttpClient(server_->address()).Ask(std::string(HttpServer::kMaxRequestBytes, 'x')), IsRefused("414"));
}

TEST_F(ServeMetricsTest, OneAddressCannotTakeAllConnections) {
  std::vector<std::unique_ptr<HttpClient>> silent;
  for (int i = 0; i < HttpServer::kMaxConnections + 1; ++i)
    silent.push_back(std::make_unique<HttpClient>(server_->address()));
  EXPECT_THAT(silent.back()->Receive(), IsEmpty());  // refused at once
  EXPECT_THAT(Get("/metrics", "127.0.0.2"), StartsWith("HTTP/1.1 200 "));
}

TEST_F(ServeMetricsTest, ASlowClientIsDisconnectedEvenIfActive) {
  HttpClient client(server_->address());
  const absl::Time begin = absl::Now();
  std::thread sender([&client] {
    client.Send("GET /metrics HTTP/1.1\r\nX: ");
    for (int i = 0; i < 30; ++i) {
      absl::SleepFor(absl::Milliseconds(200));
      client.Send("x");
    }
  });
  EXPECT_THAT(client.Receive(), IsEmpty());
  EXPECT_LT(absl::Now() - begin, absl::Milliseconds(5500));  // before the sender ends
  sender.join();
}

TEST_F(ServeMetricsTest, ClosedConnectionsDoNotCount) {
  for (int i = 0; i < 3 * HttpServer::kMaxConnections; ++i) ASSERT_THAT(Get(), StartsWith("HTTP/1.1 200 ")) << i;
}

TEST_F(ServeMetricsTest, DestructorDoesNotWaitForClients) {
  const HttpClient silent(server_->address());
  HttpClient half(server_->address());
  half.Send("GET /metr");
  const absl::Time begin = absl::Now();
  server_.reset();
  EXPECT_LT(absl::Now() - begin, absl::Seconds(2));
  EXPECT_THAT(half.Receive(), IsEmpty());
}

TEST_F(ServeMetricsTest, AnAddressInUseIsRefused) {
  EXPECT_THAT(
      ServeMetrics(server_->address(), &status_, [] { return true; }),
      StatusIs(absl::StatusCode::kUnavailable, AllOf(HasSubstr("--metrics_listen"), HasSubstr(server_->address()))));
}

// The HTTP server by itself, whose timeout tests can wait for.
class HttpServerTest : public testing::Test {
 protected:
  std::string Get() { return HttpClient(server_->address()).Ask("GET / HTTP/1.1\r\nHost: a\r\n\r\n"); }

  const std::unique_ptr<HttpServer> server_ =
      *HttpServer::Create({"127.0.0.1:0", {}, /*timeout=*/absl::Seconds(1)},
                          [](const HttpServer::Request&) { return HttpServer::Response(); });
};

// A line of zeros counts as empty: this client waits until the timeout.
TEST_F(HttpServerTest, EmptyLinesBeforeARequestAreIgnored) {
  EXPECT_THAT(HttpClient(server_->address()).Ask(std::string(100, '\0') + "\r\n\r\n"), IsEmpty());
}

TEST_F(HttpServerTest, SilentClientsAreDisconnectedAndBlockNoOthers) {
  std::vector<std::unique_ptr<HttpClient>> silent;
  for (int i = 0; i < HttpServer::kMaxConnectionsPerClient - 1; ++i) {
    silent.push_back(std::make_unique<HttpClient>(server_->address()));
  }
  EXPECT_THAT(Get(), StartsWith("HTTP/1.1 200 "));
  for (const auto& client : silent) EXPECT_THAT(client->Receive(), IsEmpty());
}

// Damaged input gets an HTTP answer or none, and the next client is served.
TEST_F(HttpServerTest, SurvivesDamagedRequests) {
  std::mt19937 random(1);
  const std::string sound = "GET /metrics?x=%41 HTTP/1.1\r\nHost: 127.0.0.1:9090\r\nContent-Length: 2\r\n\r\nab";
  for (int batch = 0; batch < 2; ++batch) {
    std::vector<std::unique_ptr<HttpClient>> clients;
    for (int i = 0; i < HttpServer::kMaxConnectionsPerClient - 4; ++i) {
      std::string request = sound;
      for (unsigned changes = random() % 6 + 1; changes > 0; --changes) {
        const size_t at = random() % request.size();
        if (random() % 2 == 0) request[at] = static_cast<char>(random());
        if (random() % 4 == 0) request.insert(at, sound, random() % sound.size());
        if (random() % 4 == 0) request.resize(at + 1);
      }
      clients.push_back(std::make_unique<HttpClient>(server_->address()));
      clients.back()->Send(request);
      clients.back()->EndSending();
    }
    for (const auto& client : clients) EXPECT_THAT(client->Receive(), AnyOf(IsEmpty(), StartsWith("HTTP/1.")));
  }
  EXPECT_THAT(Get(), StartsWith("HTTP/1.1 200 "));
}

// A client that closed its half of the connection costs no CPU time while the server waits for it.
TEST_F(HttpServerTest, HalfClosedConnectionsCostNoCpu) {
  const std::clock_t begin = std::clock();
  HttpClient client(server_->address());
  client.Send("POST /metrics HTTP/1.1\r\nHost: a\r\nContent-Le");
  client.EndSending();
  EXPECT_THAT(client.Receive(), IsEmpty());
  EXPECT_LT(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC, 0.5);
}

TEST(CheckMetricsAddress, RefusesWhatIsNoAddressOrReachesBeyondThisHost) {
  EXPECT_THAT(CheckMetricsAddress("0.0.0.0:0", /*insecure=*/false),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("--metrics_listen=0.0.0.0:0"), HasSubstr("--metrics_insecure"))));
  EXPECT_THAT(CheckMetricsAddress("0.0.0.0:0", /*insecure=*/true), IsOk());
  EXPECT_THAT(CheckMetricsAddress("nonsense", /*insecure=*/false),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--metrics_listen")));
  EXPECT_THAT(CheckMetricsAddress("unix:/tmp/x", /*insecure=*/false),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want HOST:PORT")));
}

}  // namespace
}  // namespace craftfleet::wire
