#include "common/wire/hand_over.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <memory>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/closable_queue.h"
#include "tests/fakes/is_closed.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

// Its servers read until a connection ends, as gRPC may while a client keeps sending.
class HandOverTest : public testing::Test {
 protected:
  HandOverTest() {
    const HandOver::Handle serve = [this](int descriptor) {
      EXPECT_THAT(served_.Push(descriptor), IsOk());
      char byte = 0;
      while (recv(descriptor, &byte, 1, 0) > 0) {
      }
      close(descriptor);
    };
    hand_over_ = std::make_unique<HandOver>(std::vector<HandOver::Handle>{serve, serve});
  }

  // The client's side of a new connection.
  int Add() {
    int pair[2];
    EXPECT_EQ(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair), 0);
    hand_over_->Add(pair[0]);
    return pair[1];
  }
  bool IsServed() { return served_.Pop(absl::Seconds(20)).has_value(); }

  ClosableQueue<int> served_{100};
  std::unique_ptr<HandOver> hand_over_;
};

TEST_F(HandOverTest, OthersAreHandedOverWhileOneTakesLong) {
  const int sends_for_ever = Add();
  EXPECT_TRUE(IsServed());
  for (int i = 0; i < 3; ++i) {
    const int client = Add();
    EXPECT_TRUE(IsServed());
    close(client);
  }
  close(sends_for_ever);
}

// The listener has a descriptor of it too, so that closing ours alone left the client waiting.
TEST_F(HandOverTest, AConnectionThatCannotBeHandedOverEnds) {
  int pair[2];
  ASSERT_EQ(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair), 0);
  const int of_listener = fcntl(pair[0], F_DUPFD_CLOEXEC, 0);
  rlimit limit = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &limit), 0);
  HandOver& hand_over = *hand_over_;  // before the limit: UBSan needs a descriptor to look at the fixture
  const rlimit few = {static_cast<rlim_t>(of_listener) + 1, limit.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  std::vector<int> others;
  for (int other = dup(of_listener); other >= 0; other = dup(of_listener)) others.push_back(other);
  hand_over.Add(pair[0]);
  pollfd end = {pair[1], POLLIN, 0};
  EXPECT_EQ(poll(&end, 1, 20'000), 1) << "the client waits";
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
  for (const int other : others) close(other);
  close(of_listener);
  close(pair[1]);
}

TEST_F(HandOverTest, SlowOnesAreReset) {
  const int first = Add();
  const int second = Add();
  const int third = Add();
  EXPECT_TRUE(IsServed());
  EXPECT_TRUE(IsServed());
  EXPECT_EQ(hand_over_->ResetSlow(absl::Hours(1)), 0);
  EXPECT_EQ(hand_over_->ResetSlow(absl::ZeroDuration()), 2);
  EXPECT_TRUE(IsServed());  // the third
  EXPECT_TRUE(WaitUntil([&] { return IsClosed(first) && IsClosed(second); }));
  EXPECT_FALSE(IsClosed(third));
  for (const int client : {first, second, third}) close(client);
}

TEST_F(HandOverTest, EndsWhileClientsAreConnected) {
  const int clients[] = {Add(), Add(), Add()};
  EXPECT_TRUE(IsServed());
  EXPECT_TRUE(IsServed());
  hand_over_.reset();
  for (const int client : clients) {
    EXPECT_TRUE(IsClosed(client));
    close(client);
  }
}

}  // namespace
}  // namespace craftfleet::wire
