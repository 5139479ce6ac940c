#include "common/wire/listen_socket.h"

#include <string>

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

TEST(ListenSocket, ReleasesItsPort) { ListenOn(ListenOn("127.0.0.1:0")); }

}  // namespace
}  // namespace craftfleet::wire
