#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/worker_registry.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr absl::Duration kLapse = absl::Seconds(10);

class RegistryNamesTest : public testing::Test {
 protected:
  absl::Status Use(absl::string_view role, absl::string_view name, absl::string_view identity) {
    return registry_.UseName(RoleOf(role), name, identity);
  }
  void Leave(absl::string_view role, absl::string_view name, absl::string_view identity) {
    EXPECT_THAT(registry_.Leave(identity, RoleOf(role), name), IsOk());
  }
  static WorkerRegistry::Options Options() {
    WorkerRegistry::Options options;
    options.lanes.lanes = 1;
    options.name_lapse = kLapse;
    return options;
  }
  static WorkerRole RoleOf(absl::string_view role) {
    return role == "actor" ? WorkerRole::kActor : WorkerRole::kEnvServer;
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
  for (size_t i = 0; i < WorkerRegistry::kMaxNames; ++i) ASSERT_THAT(Use("actor", absl::StrCat(i), "one"), IsOk());
  EXPECT_THAT(Use("actor", "more", "one"),
              StatusIs(absl::StatusCode::kResourceExhausted, AllOf(HasSubstr("\"more\""), HasSubstr("16384"))));
  EXPECT_THAT(Use("actor", "0", "one"), IsOk());
  EXPECT_THAT(Use("actor", "more", "two"), IsOk());
  clock_.Advance(kLapse);
  EXPECT_THAT(Use("actor", "another", "one"), IsOk());
}

}  // namespace
}  // namespace craftfleet
