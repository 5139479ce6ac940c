// A learner that sends more bytes of weights than the agent of its run needs.

#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class LargeWeightsTest : public FleetRunTest {
 protected:
  void SetUp() override { shared_ = std::make_unique<TempFolder>(); }
};

TEST_F(LargeWeightsTest, AreRefusedByTheActorAtTheFirstChunk) {
  const auto learner = Start("bad_peer", "learner", {"--role=learner", "--misdeed=flooding"});
  const std::string address = learner->WaitForAddress("listening on ", kPatience).value();
  const auto server = StartServer("server");
  const auto actor = StartActor("actor", address, server->WaitForAddress().value());
  EXPECT_EQ(actor->Wait(kPatience), 1) << actor->Err();
  EXPECT_THAT(actor->Err(), AllOf(HasSubstr("learner " + address),
                                  HasSubstr("weights of the run's agent: total_bytes: 2147483648, want 1..24")));
}

}  // namespace
}  // namespace craftfleet
