#include "actor/env_server_tracker.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;

std::vector<std::string> Addresses(const std::vector<v1::Peer>& peers) {
  std::vector<std::string> addresses;
  for (const v1::Peer& peer : peers) addresses.push_back(peer.address());
  return addresses;
}

TEST(EnvServerTracker, CombinesTheReportsOfLoops) {
  EnvServerTracker tracker;
  v1::ProcessSummary summary;
  summary.set_memory_bytes(77);
  tracker.Update(0, {{"b:1", true, 3, summary, ""}, {"a:1", false, 0, {}, ""}});
  tracker.Update(1, {{"b:1", true, 4, summary, ""}, {"a:1", false, 0, {}, ""}, {"c:1", false, 0, {}, ""}});
  tracker.Update(1, {{"b:1", false, 4, {}, ""}, {"a:1", false, 0, {}, ""}});
  const std::vector<v1::Peer> all = tracker.All();
  ASSERT_EQ(all.size(), 2);
  EXPECT_EQ(all[0].address(), "a:1");
  EXPECT_EQ(all[0].health(), v1::Peer::LOST);
  EXPECT_FALSE(all[0].has_summary());
  EXPECT_EQ(all[1].address(), "b:1");
  EXPECT_EQ(all[1].health(), v1::Peer::OK);
  EXPECT_EQ(all[1].state(), "7 lanes");
  EXPECT_EQ(all[1].summary().memory_bytes(), 77);
}

TEST(EnvServerTracker, ASummaryOfAServerWithoutGamesIsOutdated) {
  EnvServerTracker tracker;
  v1::ProcessSummary summary;
  summary.set_memory_bytes(77);
  tracker.Update(0, {{"a:1", true, 0, summary, ""}, {"b:1", true, 1, summary, ""}});
  EXPECT_FALSE(tracker.All()[0].has_summary());
  EXPECT_TRUE(tracker.All()[1].has_summary());
  tracker.Update(1, {{"b:1", true, 1, {}, ""}});
  EXPECT_TRUE(tracker.All()[1].has_summary()) << "another loop's";
}

TEST(EnvServerTracker, AServerThatDoesNotAnswerIsShownAsNotAnswering) {
  EnvServerTracker tracker;
  tracker.Update(0,
                 {{"a:1", true, 2, {}, "no answer within 10s"}, {"b:1", true, 1, {}, ""}, {"c:1", false, 0, {}, ""}});
  tracker.Update(1, {{"a:1", true, 1, {}, ""}, {"b:1", true, 1, {}, ""}});
  EXPECT_EQ(tracker.All()[0].health(), v1::Peer::NOT_ANSWERING);
  EXPECT_EQ(tracker.All()[0].state(), "not answering");
  EXPECT_EQ(tracker.All()[1].health(), v1::Peer::OK);
  EXPECT_THAT(Addresses(tracker.NextUnusable(8)), ElementsAre("a:1", "c:1"));
}

TEST(EnvServerTracker, ASlowServerIsShownWithItsStepTime) {
  EnvServerTracker tracker;
  tracker.Update(0, {{"a:1", false, 0, {}, "slow", true, absl::Milliseconds(430)},
                     {"b:1", true, 1, {}, "", false, absl::Milliseconds(3)}});
  EXPECT_EQ(tracker.All()[0].health(), v1::Peer::SLOW);
  EXPECT_EQ(tracker.All()[0].step_ms(), 430);
  EXPECT_EQ(tracker.All()[0].state(), "0 lanes, 430.0 ms a step");
  EXPECT_EQ(tracker.All()[1].health(), v1::Peer::OK);
  EXPECT_EQ(tracker.All()[1].step_ms(), 3);
  EXPECT_THAT(Addresses(tracker.NextUnusable(8)), ElementsAre("a:1"));
}

TEST(EnvServerTracker, NextGoesThroughAllServersInTurn) {
  EnvServerTracker tracker;
  tracker.Update(0, {{"a", true, 1, {}, ""}, {"b", true, 1, {}, ""}, {"c", true, 1, {}, ""}});
  EXPECT_THAT(Addresses(tracker.Next(2)), ElementsAre("a", "b"));
  EXPECT_THAT(Addresses(tracker.Next(2)), ElementsAre("c", "a"));
  EXPECT_THAT(Addresses(tracker.Next(2)), ElementsAre("b", "c"));
  EXPECT_THAT(Addresses(tracker.Next(9)), ElementsAre("a", "b", "c"));
  tracker.Update(0, {});
  EXPECT_THAT(tracker.Next(2), ElementsAre());
}

}  // namespace
}  // namespace craftfleet
