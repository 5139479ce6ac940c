#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/scheduling/worker_registry.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr absl::Duration kLapse = absl::Seconds(10);

class RegistryNamesTest : public testing::Test {
 protected:
  absl::Status Use(absl::string_view role, absl::string_view name, const std::string& identity,
                   const std::string& host = "") {
    return registry_.UseName(RoleOf(role), name, {identity, host});
  }
  void Leave(absl::string_view role, absl::string_view name, const std::string& identity) {
    EXPECT_THAT(registry_.Leave({identity}, RoleOf(role), name), IsOk());
  }
  static WorkerRegistry::Options Options() {
    WorkerRegistry::Options options;
    options.lanes.lanes = 1;
    options.names.name_lapse = kLapse;
    return options;
  }
  static WorkerRole RoleOf(absl::string_view role) {
    return role == "actor" ? WorkerRole::kActor : WorkerRole::kEnvServer;
  }

  absl::Status Announce(const std::string& name, const WorkerClient& client) {
    return registry_.Announce(client, name, name + ":50061", 0, {});
  }

  FakeClock clock_;
  WorkerRegistry registry_{Options(), std::vector<LaneRecord>(1), &clock_};
};

TEST_F(RegistryNamesTest, TheFirstIdentityOwnsTheName) {
  EXPECT_THAT(Use("actor", "a", "one"), IsOk());
  EXPECT_THAT(Use("actor", "a", "one"), IsOk());
  EXPECT_THAT(Use("actor", "a", "two"),
              StatusIs(absl::StatusCode::kPermissionDenied, AllOf(HasSubstr("actor \"a\""), HasSubstr("10s"))));
  EXPECT_THAT(Use("actor", "a", ""), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"")));
  EXPECT_THAT(Use("environment server", "a", "two"), IsOk()) << "another role's name";
  EXPECT_THAT(Use("actor", "b", "two"), IsOk());
}

// A record was made for it, and its name counted.
TEST_F(RegistryNamesTest, AnUnknownWorkerLeavesWithoutARecord) {
  Leave("actor", "stranger", "one");
  EXPECT_THAT(Use("actor", "stranger", "two"), IsOk()) << "one owns no name";
}

// A worker may say that it is at another's address, to be drained in its place, or to have it drained.
TEST_F(RegistryNamesTest, AnAddressThatSeveralWorkersClaimDrainsNone) {
  ASSERT_THAT(registry_.Join({"one"}, "a", "10.0.0.1:50052", {}), IsOk());
  EXPECT_EQ(registry_.SetDraining("10.0.0.1:50052", true)->name, "a");
  EXPECT_THAT(registry_.SetDraining("a", false), IsOk());
  ASSERT_THAT(registry_.Join({"two"}, "liar", "10.0.0.1:50052", {}), IsOk());
  EXPECT_THAT(registry_.SetDraining("10.0.0.1:50052", true),
              StatusIs(absl::StatusCode::kNotFound, AllOf(HasSubstr("2 workers"), HasSubstr("a, liar"))));
  ASSERT_THAT(registry_.Join({"two"}, "second", "a", {}), IsOk()) << "a name as an address";
  EXPECT_EQ(registry_.SetDraining("a", true)->name, "a");
}

TEST_F(RegistryNamesTest, ANameIsFreeAfterItsOwnerLeftOrWasSilent) {
  EXPECT_THAT(Use("actor", "a", "one"), IsOk());
  Leave("actor", "a", "one");
  EXPECT_THAT(Use("actor", "a", "two"), IsOk());
  clock_.Advance(kLapse - absl::Milliseconds(1));
  EXPECT_THAT(Use("actor", "a", "one"), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"")));
  EXPECT_THAT(Use("actor", "a", "two"), IsOk()) << "only the owner's calls renew the name";
  clock_.Advance(kLapse - absl::Milliseconds(1));
  EXPECT_THAT(Use("actor", "a", "one"), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"")));
  clock_.Advance(absl::Milliseconds(1));
  EXPECT_THAT(Use("actor", "a", "one"), IsOk());
  Leave("actor", "nobody", "one");
}

TEST_F(RegistryNamesTest, WithoutCertificatesAllWorkersShareAnIdentity) {
  EXPECT_THAT(Use("actor", "a", ""), IsOk());
  EXPECT_THAT(Use("actor", "a", ""), IsOk());
}

TEST_F(RegistryNamesTest, TheNamesOfAnIdentityAreBounded) {
  for (size_t i = 0; i < WorkerTable::kMaxNames; ++i) {
    ASSERT_THAT(Use("actor", absl::StrCat(i), "one", absl::StrCat("host", i % 64)), IsOk());
  }
  EXPECT_THAT(Use("actor", "more", "one", "another host"),
              StatusIs(absl::StatusCode::kResourceExhausted, AllOf(HasSubstr("\"more\""), HasSubstr("16384"))));
  EXPECT_THAT(Use("actor", "0", "one"), IsOk());
  EXPECT_THAT(Use("actor", "more", "two"), IsOk());
  clock_.Advance(kLapse);
  EXPECT_THAT(Use("actor", "another", "one"), IsOk());
}

TEST_F(RegistryNamesTest, MadeUpServersOfOneClientAreBoundedAndTakeNothingFromOthers) {
  const WorkerClient one = {"", "10.0.0.1"};
  const WorkerClient two = {"", "10.0.0.2"};
  const WorkerClient certificate = {"certificate servers", "10.0.0.1"};
  EXPECT_THAT(Announce("honest", one), IsOk());
  const int most = WorkerTable::Options().max_names_per_client;
  ASSERT_GE(most, 512) << "a host may run hundreds of servers, and restart them at once";
  for (int i = 1; i < most; ++i) ASSERT_THAT(Announce(absl::StrCat("s", i), one), IsOk());
  EXPECT_THAT(Announce("more", one), StatusIs(absl::StatusCode::kResourceExhausted,
                                              AllOf(HasSubstr("\"more\""), HasSubstr("10.0.0.1 already has 2048"))));
  EXPECT_THAT(Announce("honest", one), IsOk());
  EXPECT_THAT(Announce("more", two), IsOk());
  EXPECT_THAT(Announce("secured", certificate), IsOk()) << "another identity on the same host";
  EXPECT_EQ(registry_.Workers().size(), most + 2);
  EXPECT_THAT(registry_.Leave(one, WorkerRole::kEnvServer, "s1"), IsOk());
  EXPECT_THAT(Announce("another", one), IsOk()) << "one left";
  EXPECT_THAT(Use("actor", "a", "", "10.0.0.1"), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("actor")));
  clock_.Advance(kLapse);
  EXPECT_THAT(Announce("later", one), IsOk()) << "names lapse";
}

}  // namespace
}  // namespace craftfleet
