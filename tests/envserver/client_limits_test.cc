// EnvServiceImpl: what one client may have.
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/status_macros.h"
#include "common/io/paths.h"
#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "tests/envserver/test_session.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// A server for four games; two of one client.
class ClientLimits : public testing::Test {
 protected:
  ClientLimits() {
    options_.budget.session_games = 1;
    options_.budget.games = 4;
    options_.budget.client_percent = 50;
  }

  void Serve(const wire::Server::Options& options) {
    service_ = *EnvServiceImpl::Create(*DefaultTextureDir(), options_);
    server_ = *wire::Server::Create(options, {service_.get()});
  }
  // A session with a game of `client`; or why it has none.
  static absl::StatusOr<std::unique_ptr<Session>> Play(const wire::Endpoint& client) {
    auto session = std::make_unique<Session>(client);
    CRAFTFLEET_RETURN_IF_ERROR(session->Send(Hello("run-a")).status());
    CRAFTFLEET_RETURN_IF_ERROR(session->Send(Open(0, 1)).status());
    return session;
  }

  EnvServiceImpl::Options options_;
  std::unique_ptr<EnvServiceImpl> service_;
  std::unique_ptr<wire::Server> server_;
};

// Processes of one host with certificates of their own do not share a limit.
TEST_F(ClientLimits, AClientIsItsCertificate) {
  const TempFolder folder;
  TestAuthority authority(folder, "ca");
  for (const char* name : {"server", "one", "two"}) authority.Issue(name, {name});
  const auto files = [&](const std::string& name) {
    return wire::TlsFiles{folder / (name + ".pem"), folder / (name + ".key"), folder / "ca.pem"};
  };
  wire::Server::Options listen;
  listen.address = "127.0.0.1:0";
  listen.files = files("server");
  Serve(listen);
  const auto client = [&](const std::string& name) {
    return wire::Connect(server_->address(), *wire::ChannelSecurity::Create({files(name), ""}));
  };
  const auto first = Play(client("one"));
  ASSERT_THAT(first, IsOk());
  const auto second = Play(client("one"));
  ASSERT_THAT(second, IsOk());
  EXPECT_THAT(Play(client("one")),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("games of one client: 3 requested, at most 2 (--max_client_percent)")));
  const auto other = Play(client("two"));
  EXPECT_THAT(other, IsOk());
}

// An actor that connects again needs the room of the session that it has lost.
TEST_F(ClientLimits, ItsOwnIdleSessionsMakeRoomForAClientAndNoOthers) {
  options_.gives_way = absl::ZeroDuration();
  Serve({"127.0.0.1:0"});
  const auto other = Play(server_->InProcess());  // idle for longest
  ASSERT_THAT(other, IsOk());
  const auto first = Play(wire::Connect(server_->address()));
  ASSERT_THAT(first, IsOk());
  const auto second = Play(wire::Connect(server_->address()));
  ASSERT_THAT(second, IsOk());
  EXPECT_TRUE(WaitUntil([&] { return Play(wire::Connect(server_->address())).ok(); }));
  EXPECT_FALSE((*first)->Send(Step({0}, "\x01")).ok());
  EXPECT_THAT((*other)->Send(Step({0}, "\x01")), IsOk());
}

}  // namespace
}  // namespace craftfleet
