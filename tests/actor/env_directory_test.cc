#include "actor/env_directory.h"

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
  EXPECT_THAT(EnvDirectory::Parse("envservers", "dns:a"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--envservers: \"a\"")));
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

}  // namespace
}  // namespace craftfleet
