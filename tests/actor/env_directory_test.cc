#include "actor/env_directory.h"

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

std::vector<std::string> AddressesOf(const EnvDirectory& directory) {
  std::vector<std::string> addresses;
  for (const wire::Endpoint& server : directory.Servers()) addresses.push_back(server.address);
  return addresses;
}

TEST(EnvDirectory, ListsTheGivenServers) {
  const auto directory = EnvDirectory::Parse("envservers", "10.0.0.2:1,10.0.0.1:1,,unix:/tmp/s");
  ASSERT_THAT(directory, IsOk());
  EXPECT_THAT(AddressesOf(**directory), ElementsAre("10.0.0.1:1", "10.0.0.2:1", "unix:/tmp/s"));
  EXPECT_FALSE((*directory)->uses_registry());
}

TEST(EnvDirectory, AnInvalidEntryIsNamed) {
  EXPECT_THAT(EnvDirectory::Parse("envservers", "a:1,b"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--envservers: \"b\"")));
  for (const char* entry : {"dns:a", "dns:unix:/a"}) {
    EXPECT_THAT(EnvDirectory::Parse("envservers", entry),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         absl::StrCat("--envservers: \"", entry, "\" is not an address, want dns:HOST:PORT")));
  }
  for (const char* list : {"", " ", ","}) {
    EXPECT_THAT(EnvDirectory::Parse("envservers", list),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--envservers is empty")));
  }
}

TEST(EnvDirectory, FollowsTheLearnersRegistry) {
  const auto directory = EnvDirectory::Parse("envservers", "learner,a:1").value();
  ASSERT_TRUE(directory->uses_registry());
  const std::vector<std::string> both = {"b:1", "c:1"};
  directory->SetRegistered(both);
  EXPECT_THAT(AddressesOf(*directory), ElementsAre("a:1", "b:1", "c:1"));
  const int64_t generation = directory->generation();
  directory->SetRegistered(both);
  EXPECT_EQ(directory->generation(), generation) << "nothing has changed";
  directory->SetRegistered({both[1]});
  EXPECT_NE(directory->generation(), generation);
  EXPECT_THAT(AddressesOf(*directory), ElementsAre("a:1", "c:1"));
}

TEST(EnvDirectory, ResolvesEveryAddressOfAName) {
  const auto directory = EnvDirectory::Parse("envservers", "dns:localhost:50061,dns:no-such-host.invalid:1").value();
  ASSERT_TRUE(WaitUntil([&] { return !directory->Servers().empty(); }));
  for (const std::string& address : AddressesOf(*directory)) {
    EXPECT_TRUE(address == "127.0.0.1:50061" || address == "[::1]:50061") << address;
  }
}

TEST(EnvDirectory, ResolvesAnIpv6Address) {
  const auto directory = EnvDirectory::Parse("envservers", "dns:[::1]:1").value();
  ASSERT_TRUE(WaitUntil([&] { return !directory->Servers().empty(); }));
  EXPECT_THAT(AddressesOf(*directory), ElementsAre("[::1]:1"));
}

// The success of another name made it a new error in each round.
TEST(EnvDirectory, ANameThatCannotBeLookedUpIsNamedOnce) {
  const std::string bad = absl::StrCat("dns:", std::string(64, 'a'), ":1");  // longer than a label may be
  testing::internal::CaptureStderr();
  const auto directory =
      EnvDirectory::Parse("envservers", absl::StrCat(bad, ",dns:127.0.0.1:1,", bad, ",dns:127.0.0.1:2")).value();
  EXPECT_TRUE(WaitUntil([&] { return directory->Servers().size() == 2; }));
  const std::string log = testing::internal::GetCapturedStderr();
  const std::vector<std::string> parts = absl::StrSplit(log, "no address for");
  EXPECT_EQ(parts.size(), 2U) << log;
}

}  // namespace
}  // namespace craftfleet
