#include <algorithm>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace registry_servers_test {

using testing::ElementsAre;
using testing::IsEmpty;

constexpr absl::Duration kLease = absl::Seconds(5);

class RegistryServersTest : public testing::Test {
 protected:
  static TestRegistry::Options Options() {
    TestRegistry::Options options;
    options.lanes.lanes = 1;
    options.server_lease = kLease;
    return options;
  }
  static TestRegistry::PermitRequest Question(int64_t generation) {
    TestRegistry::PermitRequest request = TestRegistry::RequestOf("asks", {}, 0);
    request.wants_servers = true;
    request.servers_generation = generation;
    return request;
  }
  // The reply to an actor with the list of `generation` (0: none).
  static TestRegistry::PermitReply Ask(TestRegistry* registry, int64_t generation) {
    registry->Join("asks", "");
    const auto reply = registry->GetPermits(Question(generation));
    EXPECT_THAT(reply, IsOk());
    return reply.value_or(TestRegistry::PermitReply());
  }
  // Whether the reply lets the actor keep that list.
  static bool ShouldKeep(TestRegistry* registry, int64_t generation) {
    return generation != 0 && Ask(registry, generation).servers_generation == generation &&
           Ask(registry, 0).servers_generation != generation;
  }
  std::vector<std::string> Addresses() {
    const TestRegistry::PermitReply reply = Ask(&registry_, 0);
    generation_ = reply.servers_generation;
    return reply.servers;
  }
  void Announce(const std::string& name, const std::string& address, int lanes = 0) {
    EXPECT_THAT(registry_.Announce({}, name, address, lanes, {}), IsOk());
  }
  void Leave(const std::string& name) {
    EXPECT_THAT(static_cast<WorkerRegistry&>(registry_).Leave({}, WorkerRole::kEnvServer, name), IsOk());
  }
  bool IsDrained(const std::string& name) {
    return static_cast<WorkerRegistry&>(registry_).IsDrained({WorkerRole::kEnvServer, name});
  }

  FakeClock clock_;
  TestRegistry registry_{Options(), &clock_};
  int64_t generation_ = 0;
};

TEST_F(RegistryServersTest, ServersComeAndGo) {
  EXPECT_THAT(Addresses(), IsEmpty());
  Announce("s1", "a:1");
  Announce("s2", "b:1");
  EXPECT_THAT(Addresses(), ElementsAre("a:1", "b:1"));
  Leave("s1");
  Leave("nobody");
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
}

TEST_F(RegistryServersTest, TheGenerationChangesOnlyWithTheAddresses) {
  Announce("s1", "a:1");
  Addresses();
  const int64_t before = generation_;
  ASSERT_GT(before, 0);
  Announce("s1", "a:1");
  Addresses();
  EXPECT_EQ(generation_, before);
  Announce("s1 restarted", "a:1");
  Addresses();
  EXPECT_EQ(generation_, before) << "actors notice it in their sessions";
  Announce("s2", "a:2");
  EXPECT_THAT(Addresses(), ElementsAre("a:1", "a:2"));
  EXPECT_NE(generation_, before);
}

TEST_F(RegistryServersTest, AfterARestartActorsKeepTheirListUntilServersCanHaveRegistered) {
  Announce("s1", "a:1");
  Addresses();
  const int64_t before = generation_;
  EXPECT_EQ(Ask(&registry_, before - 1).servers_generation, before) << "the learner has not restarted";

  clock_.Advance(absl::Seconds(1) + absl::Nanoseconds(300));
  TestRegistry restarted(Options(), &clock_);
  const int64_t first = Ask(&restarted, 0).servers_generation;
  EXPECT_FALSE(ShouldKeep(&restarted, first));
  EXPECT_TRUE(ShouldKeep(&restarted, before));
  EXPECT_THAT(restarted.Announce({}, "s2", "b:1", 0, {}), IsOk());
  EXPECT_THAT(Ask(&restarted, 0).servers, ElementsAre("b:1")) << "any server is better than none";
  const int64_t now = Ask(&restarted, 0).servers_generation;
  EXPECT_GT(now, before) << "lists of different starts are never confused";
  EXPECT_TRUE(ShouldKeep(&restarted, before));
  clock_.Advance(kLease);
  EXPECT_FALSE(ShouldKeep(&restarted, before));
}

TEST_F(RegistryServersTest, TheyKeepItAlsoIfTheDateWasSetBack) {
  Announce("s1", "a:1");
  Addresses();
  const int64_t before = generation_;
  clock_.SetWallAhead(-absl::Hours(1));
  TestRegistry restarted(Options(), &clock_);
  EXPECT_TRUE(ShouldKeep(&restarted, before));
  EXPECT_FALSE(ShouldKeep(&restarted, Ask(&restarted, 0).servers_generation));
  EXPECT_TRUE(ShouldKeep(&restarted, before));
  clock_.Advance(kLease);
  EXPECT_FALSE(ShouldKeep(&restarted, before));
}

TEST_F(RegistryServersTest, ASilentServerIsNoLongerListed) {
  Announce("s1", "a:1");
  Announce("s2", "b:1");
  clock_.Advance(kLease / 2);
  Announce("s2", "b:1");
  clock_.Advance(kLease / 2);
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
}

TEST_F(RegistryServersTest, ARestartedServerReplacesItsOldRecord) {
  Announce("host-1-aaaa", "a:1");
  Announce("host-2-bbbb", "a:1");
  EXPECT_THAT(Addresses(), ElementsAre("a:1"));
  Leave("host-1-aaaa");  // a late call of the old process
  EXPECT_THAT(Addresses(), ElementsAre("a:1"));
}

TEST_F(RegistryServersTest, ADrainedServerIsNotListedAndReportsWhenItIsEmpty) {
  Announce("s1", "a:1", 3);
  Announce("s2", "b:1", 0);
  EXPECT_THAT(Addresses(), ElementsAre("a:1", "b:1"));
  const int64_t before = generation_;
  registry_.Drain("s1");
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
  EXPECT_NE(generation_, before);
  EXPECT_EQ(registry_.Servers().size(), 2);
  EXPECT_FALSE(IsDrained("s1"));
  Announce("s1", "a:1", 1);
  EXPECT_FALSE(IsDrained("s1"));
  Announce("s1", "a:1", 0);
  EXPECT_TRUE(IsDrained("s1"));
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
  EXPECT_FALSE(IsDrained("s2"));
}

TEST_F(RegistryServersTest, TheNextProcessAtAnAddressIsNotDrained) {
  Announce("s1", "a:1", 0);
  registry_.Drain("s1");
  Announce("s1 again", "a:1", 0);
  EXPECT_THAT(Addresses(), ElementsAre("a:1"));
  EXPECT_TRUE(IsDrained("s1"));
}

TEST_F(RegistryServersTest, AnUndrainedServerIsListedAgain) {
  Announce("s1", "a:1", 3);
  registry_.Drain("a:1");
  EXPECT_THAT(Addresses(), IsEmpty());
  const int64_t before = generation_;
  EXPECT_THAT(registry_.Undrain("s1"), IsOk());
  EXPECT_THAT(Addresses(), ElementsAre("a:1"));
  EXPECT_NE(generation_, before);
  EXPECT_FALSE(registry_.Servers()[0].draining);
}

TEST_F(RegistryServersTest, AServerThatMovesIsListedOnlyAtItsNewAddress) {
  Announce("s1", "a:1");
  Announce("s1", "b:1");
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
}

// A client could fill the registry with them.
TEST_F(RegistryServersTest, ServersThatActorsReportAreBounded) {
  registry_.Join("asks", "");
  for (int i = 0; i < 2 * ServerReports::kMaxReported; ++i) {
    TestRegistry::PermitRequest request = TestRegistry::RequestOf("asks", {}, 0);
    request.servers = {{"made-up:" + std::to_string(i), /*answers=*/true, /*hangs=*/false, nullptr}};
    ASSERT_THAT(registry_.GetPermits(request), IsOk());
  }
  EXPECT_EQ(registry_.Workers().size(), 1 + ServerReports::kMaxReported);
  clock_.Advance(absl::Minutes(11));
  registry_.Join("asks", "");
  TestRegistry::PermitRequest request = TestRegistry::RequestOf("asks", {}, 0);
  request.servers = {{"real:1", /*answers=*/true, /*hangs=*/false, nullptr}};
  ASSERT_THAT(registry_.GetPermits(request), IsOk());
  EXPECT_EQ(registry_.Workers().size(), 2) << "there is room again";
}

// Servers that register, but do not answer their neighbours, would stop them for good.
TEST_F(RegistryServersTest, AnActorThatCanUseNoneOfItsServersGetsOthers) {
  for (const size_t silent : {size_t{1}, ServerLists::kMost}) {
    SCOPED_TRACE(silent);
    TestRegistry registry(Options(), &clock_);
    EXPECT_THAT(registry.WorkerRegistry::Join({"", "host 1"}, "asks", "", {}), IsOk());
    TestRegistry::PermitRequest request = Question(0);
    request.client.host = "host 1";
    std::vector<std::string> servers;
    for (int seconds = 0; seconds <= 12; seconds += 2) {
      for (size_t i = 0; i < silent; ++i) {
        const std::string address = absl::StrCat("a:", i);
        EXPECT_THAT(registry.Announce({"", "host 1"}, address, address, 0, {}), IsOk());
        if (seconds == 0) request.servers.push_back({address, /*answers=*/false, /*hangs=*/true, nullptr});
      }
      EXPECT_THAT(registry.Announce({"", "host 2"}, "other", "b:1", 0, {}), IsOk());
      const auto reply = registry.GetPermits(request);
      ASSERT_THAT(reply, IsOk());
      request.servers_generation = reply->servers_generation;
      if (!reply->servers.empty()) servers = reply->servers;
      EXPECT_EQ(std::count(servers.begin(), servers.end(), "b:1"), seconds < 4 ? 0 : 1) << "after " << seconds << " s";
      clock_.Advance(absl::Seconds(2));
    }
    EXPECT_THAT(servers, ElementsAre("b:1"));
  }
}

}  // namespace registry_servers_test
}  // namespace craftfleet
