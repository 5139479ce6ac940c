#include "learner/fleet_book.h"

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;

v1::ProcessSummary Summary(double rate) {
  v1::ProcessSummary summary;
  summary.set_steps_per_second(rate);
  summary.set_memory_bytes(1 << 20);
  return summary;
}

v1::Peer Server(const std::string& address, v1::Peer::Health health) {
  v1::Peer peer;
  peer.set_role("envserver");
  peer.set_address(address);
  peer.set_health(health);
  *peer.mutable_summary() = Summary(7);
  return peer;
}

class FleetBookTest : public testing::Test {
 protected:
  // "actor a OK", ...
  std::vector<std::string> Lines() const {
    std::vector<std::string> lines;
    for (const v1::Peer& peer : book_.Workers()) {
      lines.push_back(absl::StrCat(peer.role(), " ", peer.name(), " ", v1::Peer::Health_Name(peer.health())));
    }
    return lines;
  }

  FakeClock clock_;
  FleetBook book_{absl::Seconds(5), &clock_};
};

TEST_F(FleetBookTest, KeepsWhatWorkersSaidLast) {
  book_.Heard("actor", "a", "host:1", {});
  book_.Heard("actor", "a", "", Summary(10));
  book_.Heard("actor", "a", "", Summary(20));
  book_.Heard("actor", "a", "", {});
  clock_.Advance(absl::Seconds(2));
  const std::vector<v1::Peer> workers = book_.Workers();
  ASSERT_EQ(workers.size(), 1);
  EXPECT_EQ(workers[0].address(), "host:1");
  EXPECT_EQ(workers[0].summary().steps_per_second(), 20);
  EXPECT_EQ(workers[0].last_seen_s(), 2);
  EXPECT_EQ(workers[0].health(), v1::Peer::OK);
}

TEST_F(FleetBookTest, SilentWorkersAreLostAndLaterForgotten) {
  book_.Heard("actor", "a", "host:1", Summary(1));
  clock_.Advance(absl::Seconds(5));
  EXPECT_THAT(Lines(), ElementsAre("actor a LOST"));
  clock_.Advance(FleetBook::kRememberLost);
  EXPECT_THAT(Lines(), ElementsAre());
}

TEST_F(FleetBookTest, WhoSaidGoodbyeHasLeft) {
  book_.Heard("envserver", "s", "host:1", Summary(1));
  book_.Left("envserver", "s");
  book_.Left("envserver", "never heard of");
  EXPECT_THAT(Lines(), ElementsAre("envserver s LEFT"));
  clock_.Advance(FleetBook::kRememberLeft + absl::Seconds(1));
  EXPECT_THAT(Lines(), ElementsAre());
}

TEST_F(FleetBookTest, AServerThatCameBackIsShownOnce) {
  book_.Heard("envserver", "s-1", "host:1", Summary(1));
  clock_.Advance(absl::Seconds(6));
  book_.Heard("envserver", "s-2", "host:1", Summary(1));
  EXPECT_THAT(Lines(), ElementsAre("envserver s-2 OK"));
}

TEST_F(FleetBookTest, ActorsSpeakForServersThatDoNot) {
  book_.HeardOf(Server("host:1", v1::Peer::OK));
  book_.HeardOf(Server("host:2", v1::Peer::LOST));
  EXPECT_THAT(Lines(), ElementsAre("envserver host:1 OK", "envserver host:2 LOST"));
  // One actor that reaches it is enough, and none leaves it lost.
  book_.HeardOf(Server("host:1", v1::Peer::LOST));
  EXPECT_THAT(Lines(), ElementsAre("envserver host:1 OK", "envserver host:2 LOST"));
  clock_.Advance(absl::Seconds(11));
  book_.HeardOf(Server("host:1", v1::Peer::LOST));
  EXPECT_THAT(Lines(), ElementsAre("envserver host:1 LOST", "envserver host:2 LOST"));
}

TEST_F(FleetBookTest, WhatAServerSaidLongAgoIsNotWhatItDoes) {
  book_.HeardOf(Server("host:1", v1::Peer::OK));
  v1::Peer silent = Server("host:1", v1::Peer::OK);
  silent.clear_summary();
  book_.HeardOf(silent);
  EXPECT_EQ(book_.Workers()[0].summary().steps_per_second(), 7);
  clock_.Advance(absl::Seconds(11));
  book_.HeardOf(silent);
  EXPECT_EQ(book_.Workers()[0].health(), v1::Peer::OK);
  EXPECT_EQ(book_.Workers()[0].summary().steps_per_second(), 0);
  EXPECT_GT(book_.Workers()[0].summary().memory_bytes(), 0);
}

TEST_F(FleetBookTest, WhoIsGoneDoesNothing) {
  book_.Heard("actor", "a", "", Summary(9));
  EXPECT_EQ(book_.Workers()[0].summary().steps_per_second(), 9);
  book_.Left("actor", "a");
  EXPECT_EQ(book_.Workers()[0].health(), v1::Peer::LEFT);
  EXPECT_EQ(book_.Workers()[0].summary().steps_per_second(), 0);
}

TEST_F(FleetBookTest, AServersOwnWordCountsMore) {
  book_.HeardOf(Server("host:1", v1::Peer::OK));
  book_.Heard("envserver", "s", "host:1", Summary(9));
  book_.HeardOf(Server("host:1", v1::Peer::OK));
  EXPECT_THAT(Lines(), ElementsAre("envserver s OK"));
  EXPECT_EQ(book_.Workers()[0].summary().steps_per_second(), 9);
}

TEST_F(FleetBookTest, OnlyTheNewestOfMuchThatIsGoneAreKept) {
  for (int i = 0; i < 1000; ++i) {
    book_.Heard("actor", absl::StrCat("a", i), "", {});
    clock_.Advance(absl::Milliseconds(10));
  }
  clock_.Advance(absl::Seconds(10));
  book_.Heard("actor", "b", "", {});
  const std::vector<std::string> lines = Lines();
  EXPECT_EQ(lines.size(), FleetBook::kMaxGone + 1);
  EXPECT_EQ(lines.back(), "actor b OK");
  EXPECT_THAT(lines, testing::Contains("actor a999 LOST"));
}

TEST_F(FleetBookTest, WhatAWorkerSendsIsCut) {
  v1::ProcessSummary summary = Summary(1);
  summary.set_last_error(std::string(100000, 'x'));
  for (int i = 0; i < 1000; ++i) summary.add_times();
  book_.Heard("actor", "a", "", summary);
  EXPECT_LT(book_.Workers()[0].ByteSizeLong(), 1000);
  summary.clear_times();
  summary.add_times()->set_activity(std::string(100000, 'x'));
  book_.Heard("actor", "a", "", summary);
  EXPECT_LT(book_.Workers()[0].ByteSizeLong(), 1000);
}

}  // namespace
}  // namespace craftfleet
