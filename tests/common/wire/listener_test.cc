#include "common/wire/listener.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/numbers.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/closable_queue.h"
#include "tests/fakes/is_closed.h"
#include "tests/fakes/sanitizers.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;

int ConnectTo(const Listener& listener) {
  const int client = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  int port = 0;
  EXPECT_TRUE(absl::SimpleAtoi(listener.address().substr(listener.address().rfind(':') + 1), &port));
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  EXPECT_EQ(connect(client, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  return client;
}

class ListenerTest : public testing::Test {
 protected:
  void Listen(int max_connections_per_client) {
    listener_ = *Listener::Create({"127.0.0.1:0", max_connections_per_client});
    listener_->Start({[this](int descriptor) { EXPECT_THAT(accepted_.Push(descriptor), IsOk()); }});
  }
  int Accepted() { return accepted_.Pop(absl::Seconds(20)).value_or(-1); }

  ClosableQueue<int> accepted_{1000};
  std::unique_ptr<Listener> listener_;
};

TEST_F(ListenerTest, HandsOverConnections) {
  Listen(4);
  const int client = ConnectTo(*listener_);
  const int server = Accepted();
  ASSERT_GE(server, 0);
  EXPECT_EQ(send(client, "x", 1, 0), 1);
  char byte = 0;
  EXPECT_TRUE(WaitUntil([&] { return recv(server, &byte, 1, MSG_DONTWAIT) == 1; }));
  EXPECT_EQ(byte, 'x');
  close(server);
  close(client);
}

TEST_F(ListenerTest, RefusesAClientsConnectionsBeyondItsLimit) {
  Listen(2);
  const int first = ConnectTo(*listener_);
  const int second = ConnectTo(*listener_);
  const int server_of_first = Accepted();
  Accepted();
  const int third = ConnectTo(*listener_);
  EXPECT_TRUE(WaitUntil([&] { return IsClosed(third); }));
  EXPECT_FALSE(IsClosed(first));
  EXPECT_FALSE(IsClosed(second));

  // Either side may close a connection; then there is room for another.
  shutdown(server_of_first, SHUT_RDWR);
  close(server_of_first);
  EXPECT_TRUE(WaitUntil([&] {
    const int fourth = ConnectTo(*listener_);
    return accepted_.Pop(absl::Milliseconds(100)).has_value() || (close(fourth), false);
  }));
  close(second);
  ConnectTo(*listener_);
  EXPECT_GE(Accepted(), 0);
}

TEST_F(ListenerTest, RefusesConnectionsBeyondTheTotalLimit) {
  Listener::Options options;
  options.address = "127.0.0.1:0";
  options.max_connections = 2;
  listener_ = *Listener::Create(options);
  listener_->Start({[this](int descriptor) { EXPECT_THAT(accepted_.Push(descriptor), IsOk()); }});
  const int first = ConnectTo(*listener_);
  const int second = ConnectTo(*listener_);
  Accepted();
  Accepted();
  const int third = ConnectTo(*listener_);
  EXPECT_TRUE(WaitUntil([&] { return IsClosed(third); }));
  EXPECT_FALSE(IsClosed(first));
  close(second);
  EXPECT_TRUE(WaitUntil([&] {
    const int fourth = ConnectTo(*listener_);
    return accepted_.Pop(absl::Milliseconds(100)).has_value() || (close(fourth), false);
  }));
}

// gRPC's own listener would never accept again.
TEST_F(ListenerTest, RecoversFromALackOfDescriptors) {
  if (kAddressSanitizer) GTEST_SKIP() << "the sanitizer's type checks need descriptors themselves";
  Listen(1000);
  rlimit before = {};
  getrlimit(RLIMIT_NOFILE, &before);
  const int waiting = ConnectTo(*listener_);
  const int server = Accepted();
  // Leaves a descriptor only for the client's side of one more connection.
  const int next = dup(0);
  close(next);
  const rlimit low = {static_cast<rlim_t>(next) + 1, before.rlim_max};
  setrlimit(RLIMIT_NOFILE, &low);
  const int starved = ConnectTo(*listener_);
  EXPECT_EQ(accepted_.Pop(absl::Milliseconds(300)), std::nullopt);
  setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_GE(Accepted(), 0);
  for (const int descriptor : {waiting, server, starved}) close(descriptor);
}

TEST_F(ListenerTest, StopClosesThePortAndKeepsConnections) {
  Listen(4);
  const int client = ConnectTo(*listener_);
  const int server = Accepted();
  const std::string address = listener_->address();
  listener_->Stop();
  EXPECT_THAT(Listener::Create({address}), IsOk());
  EXPECT_FALSE(IsClosed(client));
  close(server);
  close(client);
}

// gRPC may serve a client on the thread that hands it over for as long as the client sends.
TEST_F(ListenerTest, InspectsConnectionsWhileTheyAreHandedOver) {
  listener_ = *Listener::Create({"127.0.0.1:0"});
  listener_->Start({[this](int descriptor) {
                     char byte = 0;
                     while (recv(descriptor, &byte, 1, 0) > 0 || errno == EAGAIN) {
                     }
                     EXPECT_THAT(accepted_.Push(descriptor), IsOk());
                   }},
                   [](const std::map<int, std::string>& connections) {
                     std::map<int, std::string> ended;
                     for (const auto& [connection, client] : connections) ended[connection] = "a flood";
                     return ended;
                   });
  const int client = ConnectTo(*listener_);
  close(Accepted());
  close(client);
}

TEST(Listener, NamesTheAddressItCannotListenOn) {
  const auto first = Listener::Create({"127.0.0.1:0"});
  const std::string address = (*first)->address();
  EXPECT_THAT(
      Listener::Create({address}),
      StatusIs(absl::StatusCode::kUnavailable, AllOf(HasSubstr("cannot listen on " + address), HasSubstr("in use"))));
  EXPECT_THAT(Listener::Create({"192.0.2.1:0"}),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("the host is not this machine")));
  EXPECT_THAT(Listener::Create({"no-such-host.invalid:0"}),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot listen on no-such-host.invalid:0")));
}

TEST(Listener, ListensOnBothFamiliesOfAName) {
  const auto listener = Listener::Create({"localhost:0"});
  ASSERT_THAT(listener, IsOk());
  EXPECT_THAT((*listener)->address(), testing::MatchesRegex("localhost:[1-9][0-9]*"));
}

}  // namespace
}  // namespace craftfleet::wire
