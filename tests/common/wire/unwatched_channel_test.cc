// Channels that nobody waits for, in a process that polls as actors do. A program of its own: the way to poll is set
// before gRPC starts.

#include <sys/resource.h>

#include <string>

#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

// Whether a new channel is connected by its first attempt.
bool ConnectsAtOnce(const std::string& address, const ChannelSecurity& security) {
  const Endpoint endpoint = Connect(address, security);
  grpc_connectivity_state state = GRPC_CHANNEL_IDLE;
  WaitUntil([&] {
    state = endpoint.channel->GetState(/*try_to_connect=*/true);
    return state == GRPC_CHANNEL_READY || state == GRPC_CHANNEL_TRANSIENT_FAILURE;
  });
  return state == GRPC_CHANNEL_READY;
}

// An actor looks at the state of its servers now and then. Polled every half second, the handshake of TLS took longer
// than an attempt to connect may take, and a server was used after some twelve seconds.
TEST(UnwatchedChannel, ATlsHandshakeFinishesWithinAnAttemptToConnect) {
  rlimit files = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &files), 0);
  if (files.rlim_max < kPlentyOfFiles) GTEST_SKIP() << "with so few files, actors poll in another way";
  files.rlim_cur = files.rlim_max;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &files), 0);
  PollFewConnections();
  const TempFolder folder;
  TestAuthority authority(folder, "ca");
  authority.Issue("peer", {"peer"});
  const TlsFiles tls = {folder / "peer.pem", folder / "peer.key", folder / "ca.pem"};
  Server::Options options;
  options.address = "127.0.0.1:0";
  options.files = tls;
  v1::StatusService::Service service;
  const auto server = Server::Create(options, {&service});
  ASSERT_THAT(server, IsOk());
  const auto security = ChannelSecurity::Create({tls, ""});
  ASSERT_THAT(security, IsOk());
  const auto connects = [&] { return ConnectsAtOnce((*server)->address(), *security); };
  EXPECT_TRUE(connects() || connects() || connects()) << "three attempts, as the machine may be busy";
}

}  // namespace
}  // namespace craftfleet::wire
