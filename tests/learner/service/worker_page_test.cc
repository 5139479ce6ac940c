#include "learner/service/worker_page.h"

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

using testing::Contains;
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

class WorkerPageTest : public testing::Test {
 protected:
  // An actor joins or requests permits, or a server registers.
  void Report(const std::string& role, const std::string& name, const std::string& address,
              const v1::ProcessSummary& summary) {
    if (role == "envserver") {
      EXPECT_THAT(registry_.Announce({}, name, address, 0, {}, KeepSummary(summary)), IsOk());
      return;
    }
    registry_.Join(name, address);
    TestRegistry::PermitRequest request = TestRegistry::RequestOf(name, {}, 0);
    request.summary = KeepSummary(summary);
    EXPECT_THAT(registry_.GetPermits(request), IsOk());
  }
  // The actor "asks" reports a server. Workers() omits that actor.
  void Relay(const v1::Peer& server) {
    registry_.Join("asks", "");
    TestRegistry::PermitRequest request = TestRegistry::RequestOf("asks", {}, 0);
    request.servers = {ToServerReport(server)};
    EXPECT_THAT(registry_.GetPermits(request), IsOk());
  }
  void Leave(const std::string& role, const std::string& name) {
    const WorkerRole id = role == "actor" ? WorkerRole::kActor : WorkerRole::kEnvServer;
    EXPECT_THAT(static_cast<WorkerRegistry&>(registry_).Leave({}, id, name), IsOk());
  }
  std::vector<v1::Peer> Workers() const {
    v1::StatusReply reply;
    AddWorkers(registry_, &reply);
    std::vector<v1::Peer> workers;
    for (const v1::Peer& peer : reply.peers()) {
      if (peer.name() != "asks") workers.push_back(peer);
    }
    return workers;
  }
  // "actor a OK", ...
  std::vector<std::string> Lines() const {
    std::vector<std::string> lines;
    for (const v1::Peer& peer : Workers()) {
      lines.push_back(absl::StrCat(peer.role(), " ", peer.name(), " ", v1::Peer::Health_Name(peer.health())));
    }
    return lines;
  }

  FakeClock clock_;
  TestRegistry registry_{{1}, std::vector<LaneRecord>(1), &clock_};
};

TEST_F(WorkerPageTest, ShowsTheLastReport) {
  Report("actor", "a", "host:1", {});
  Report("actor", "a", "", Summary(10));
  Report("actor", "a", "", Summary(20));
  Report("actor", "a", "", {});
  clock_.Advance(absl::Seconds(2));
  const std::vector<v1::Peer> workers = Workers();
  ASSERT_EQ(workers.size(), 1);
  EXPECT_EQ(workers[0].address(), "host:1");
  EXPECT_EQ(workers[0].summary().steps_per_second(), 20);
  EXPECT_EQ(workers[0].last_seen_s(), 2);
  EXPECT_EQ(workers[0].health(), v1::Peer::OK);
}

TEST_F(WorkerPageTest, SilentWorkersAreLostAndLaterForgotten) {
  Report("actor", "a", "host:1", Summary(1));
  clock_.Advance(absl::Seconds(5));
  EXPECT_THAT(Lines(), ElementsAre("actor a LOST"));
  clock_.Advance(WorkerTable::kRememberLost);
  EXPECT_THAT(Lines(), ElementsAre());
}

TEST_F(WorkerPageTest, AWorkerThatLeavesIsShownAsLeft) {
  Report("envserver", "s", "host:1", Summary(1));
  Leave("envserver", "s");
  Leave("envserver", "never heard of");
  EXPECT_THAT(Lines(), ElementsAre("envserver s LEFT"));
  clock_.Advance(WorkerTable::kRememberLeft + absl::Seconds(1));
  EXPECT_THAT(Lines(), ElementsAre());
}

TEST_F(WorkerPageTest, AServerThatCameBackIsShownOnce) {
  Report("envserver", "s-1", "host:1", Summary(1));
  clock_.Advance(absl::Seconds(6));
  Report("envserver", "s-2", "host:1", Summary(1));
  EXPECT_THAT(Lines(), ElementsAre("envserver s-2 OK"));
}

TEST_F(WorkerPageTest, ActorsReportForUnregisteredServers) {
  Relay(Server("host:1", v1::Peer::OK));
  Relay(Server("host:2", v1::Peer::LOST));
  EXPECT_THAT(Lines(), ElementsAre("envserver host:1 OK", "envserver host:2 LOST"));
  // A server is OK if at least one actor reaches it, else LOST.
  Relay(Server("host:1", v1::Peer::LOST));
  EXPECT_THAT(Lines(), ElementsAre("envserver host:1 OK", "envserver host:2 LOST"));
  clock_.Advance(absl::Seconds(11));
  Relay(Server("host:1", v1::Peer::LOST));
  EXPECT_THAT(Lines(), ElementsAre("envserver host:1 LOST", "envserver host:2 LOST"));
}

TEST_F(WorkerPageTest, OldFiguresOfAServerAreNotShown) {
  Relay(Server("host:1", v1::Peer::OK));
  v1::Peer silent = Server("host:1", v1::Peer::OK);
  silent.clear_summary();
  Relay(silent);
  EXPECT_EQ(Workers()[0].summary().steps_per_second(), 7);
  clock_.Advance(absl::Seconds(11));
  Relay(silent);
  EXPECT_EQ(Workers()[0].health(), v1::Peer::OK);
  EXPECT_EQ(Workers()[0].summary().steps_per_second(), 0);
  EXPECT_GT(Workers()[0].summary().memory_bytes(), 0);
}

TEST_F(WorkerPageTest, LostWorkersShowNoCurrentWork) {
  Report("actor", "a", "", Summary(9));
  EXPECT_EQ(Workers()[0].summary().steps_per_second(), 9);
  Leave("actor", "a");
  EXPECT_EQ(Workers()[0].health(), v1::Peer::LEFT);
  EXPECT_EQ(Workers()[0].summary().steps_per_second(), 0);
}

TEST_F(WorkerPageTest, AServersOwnReportTakesPrecedence) {
  Relay(Server("host:1", v1::Peer::OK));
  Report("envserver", "s", "host:1", Summary(9));
  Relay(Server("host:1", v1::Peer::OK));
  EXPECT_THAT(Lines(), ElementsAre("envserver s OK"));
  EXPECT_EQ(Workers()[0].summary().steps_per_second(), 9);
}

TEST_F(WorkerPageTest, OnlyTheNewestLostWorkersAreKept) {
  for (int i = 0; i < 1000; ++i) {
    Report("actor", absl::StrCat("a", i), "", {});
    clock_.Advance(absl::Milliseconds(10));
  }
  clock_.Advance(absl::Seconds(10));
  Report("actor", "b", "", {});
  const std::vector<std::string> lines = Lines();
  EXPECT_EQ(lines.size(), WorkerTable::kMaxGone + 1);
  EXPECT_EQ(lines.back(), "actor b OK");
  EXPECT_THAT(lines, testing::Contains("actor a999 LOST"));
}

TEST_F(WorkerPageTest, OfALargeFleetItListsTheLostFirst) {
  registry_.Join("zzz", "");
  clock_.Advance(absl::Seconds(6));
  for (size_t i = 0; i < kMaxPeers + 10; ++i) registry_.Join(absl::StrCat("actor", i), "");
  const std::vector<std::string> lines = Lines();
  EXPECT_EQ(lines.size(), kMaxPeers);
  EXPECT_THAT(lines, Contains("actor zzz LOST"));
  v1::StatusReply reply;
  EXPECT_EQ(AddWorkers(registry_, &reply).size(), kMaxPeers + 11) << "sums include all";
}

// As craftfleet admin drain waits for it. It was shown as drained, and its evaluation was lost with it.
TEST_F(WorkerPageTest, AnActorThatPlaysAnEvaluationIsNotDrained) {
  registry_.AddEvaluation({1, 0, 1, 1, /*final=*/false, nullptr});
  registry_.Join("a", "");
  TestRegistry::PermitRequest request = TestRegistry::RequestOf("a", {}, 0);
  request.evaluates = true;
  const auto reply = registry_.GetPermits(request);
  ASSERT_THAT(reply, IsOk());
  ASSERT_TRUE(reply->evaluation.has_value());
  registry_.Drain("a");
  EXPECT_EQ(Workers()[0].drain(), v1::Peer::DRAINING);
  EXPECT_THAT(Workers()[0].state(), testing::EndsWith(", draining"));
  ASSERT_THAT(registry_.FinishEvaluation("a", reply->evaluation->id, std::vector<Episode>(1)), IsOk());
  EXPECT_EQ(Workers()[0].drain(), v1::Peer::DRAINED);
  EXPECT_THAT(Workers()[0].state(), testing::EndsWith(", drained"));
}

TEST_F(WorkerPageTest, ShowsTheSizeOfAListThatHasNotAllServers) {
  for (int i = 0; i < 20; ++i) {
    const std::string number = absl::StrCat(i);
    ASSERT_THAT(registry_.Announce({}, "s" + number, "a:" + number, 0, {}), IsOk());
  }
  for (const char* actor : {"a", "b", "c", "d"}) registry_.Join(actor, "");
  for (const char* actor : {"a", "b", "c", "d", "a"}) {
    TestRegistry::PermitRequest request = TestRegistry::RequestOf(actor, {}, 0);
    request.wants_servers = true;
    ASSERT_THAT(registry_.GetPermits(request), IsOk());
  }
  EXPECT_THAT(Workers()[0].state(), testing::HasSubstr("10 of 20 servers"));
}

}  // namespace
}  // namespace craftfleet
