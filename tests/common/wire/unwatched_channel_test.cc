// Channels that nobody waits for, in a process that polls as actors do. A program of its own: the way to poll is set
// before gRPC starts.

#include <sys/resource.h>

#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

// An actor looks at the state of its servers now and then. Polled every half second, the handshake of TLS took longer
// than an attempt to connect may take, and a server was used after some twelve seconds.
TEST(UnwatchedChannel, ATlsHandshakeFinishesInItsFirstAttempts) {
  constexpr int kMaxFailures = 1;  // on a loaded machine
  rlimit files = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &files), 0);
  ASSERT_GE(files.rlim_max, kPlentyOfFiles) << "below, actors poll in another way";
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
  const auto server = Server::Create(options, {});
  ASSERT_THAT(server, IsOk());
  const auto security = ChannelSecurity::Create({tls, "", ""});
  ASSERT_THAT(security, IsOk());
  const Endpoint endpoint = Connect((*server)->address(), *security);
  int failures = 0;
  grpc_connectivity_state last = GRPC_CHANNEL_IDLE;
  EXPECT_TRUE(WaitUntil([&] {
    const grpc_connectivity_state state = endpoint.channel->GetState(/*try_to_connect=*/true);
    if (state == GRPC_CHANNEL_TRANSIENT_FAILURE && last != state) ++failures;
    last = state;
    return state == GRPC_CHANNEL_READY || failures > kMaxFailures;
  }));
  EXPECT_LE(failures, kMaxFailures);
}

}  // namespace
}  // namespace craftfleet::wire
