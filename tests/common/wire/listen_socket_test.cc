#include "common/wire/listen_socket.h"

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <string>

#include <absl/cleanup/cleanup.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::MatchesRegex;

std::string ListenOn(const std::string& address) {
  const auto socket = ListenSocket::Create(address);
  EXPECT_THAT(socket, IsOk());
  return socket.ok() ? (*socket)->address() : "";
}

TEST(ListenSocket, ListensOnAFreePortOfEachKindOfHost) {
  EXPECT_THAT(ListenOn("127.0.0.1:0"), MatchesRegex("127\\.0\\.0\\.1:[1-9][0-9]*"));
  EXPECT_THAT(ListenOn("localhost:0"), MatchesRegex("localhost:[1-9][0-9]*"));
  EXPECT_THAT(ListenOn("[::]:0"), MatchesRegex("(\\[::\\]|0\\.0\\.0\\.0):[1-9][0-9]*"));
}

TEST(ListenSocket, NamesTheAddressItCannotListenOn) {
  const auto first = ListenSocket::Create("127.0.0.1:0");
  const std::string address = (*first)->address();
  EXPECT_THAT(
      ListenSocket::Create(address),
      StatusIs(absl::StatusCode::kUnavailable, AllOf(HasSubstr("cannot listen on " + address), HasSubstr("in use"))));
  EXPECT_THAT(ListenSocket::Create("192.0.2.1:0"),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("the host is not this machine")));
  EXPECT_THAT(ListenSocket::Create("no-such-host.invalid:0"),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot listen on no-such-host.invalid:0")));
}

// It would serve IPv4 alone.
TEST(ListenSocket, APortInUseOnIpv6IsNotTakenOnIpv4) {
  const int other = socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const absl::Cleanup close_other = [other] { close(other); };
  const int on = 1;
  setsockopt(other, IPPROTO_IPV6, IPV6_V6ONLY, &on, sizeof(on));
  sockaddr_in6 any = {};
  any.sin6_family = AF_INET6;
  socklen_t size = sizeof(any);
  if (bind(other, reinterpret_cast<const sockaddr*>(&any), size) != 0) GTEST_SKIP() << "this host has no IPv6";
  ASSERT_EQ(listen(other, 1), 0);
  getsockname(other, reinterpret_cast<sockaddr*>(&any), &size);
  const std::string address = absl::StrCat("[::]:", ntohs(any.sin6_port));
  EXPECT_THAT(
      ListenSocket::Create(address),
      StatusIs(absl::StatusCode::kUnavailable, AllOf(HasSubstr("cannot listen on " + address), HasSubstr("in use"))));
}

TEST(ListenSocket, ReleasesItsPort) { ListenOn(ListenOn("127.0.0.1:0")); }

}  // namespace
}  // namespace craftfleet::wire
