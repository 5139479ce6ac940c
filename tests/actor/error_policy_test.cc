#include "actor/error_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

TEST(ErrorPolicy, NoReplyOfAnEnvironmentServerEndsAnActorWhateverItsCode) {
  for (int code = 1; code <= 16; ++code) {
    const absl::Status error(static_cast<absl::StatusCode>(code), "");
    EXPECT_NE(ReactionTo(CallKind::kSession, error), Reaction::kEnd) << error;
  }
}

TEST(ErrorPolicy, ARefusalIsRetriedExceptAtTheFirstJoin) {
  for (const absl::Status& error : {absl::PermissionDeniedError(""), absl::UnauthenticatedError("")}) {
    EXPECT_EQ(ReactionTo(CallKind::kJoin, error), Reaction::kEnd);
    for (const CallKind called : {CallKind::kPlay, CallKind::kWeights, CallKind::kSnapshot}) {
      EXPECT_EQ(ReactionTo(called, error), Reaction::kRetry);
    }
  }
}

TEST(ErrorPolicy, WeightsThatAreNotTheAgentsEndTheActor) {
  EXPECT_EQ(ReactionTo(CallKind::kWeights, absl::DataLossError("")), Reaction::kEnd);
}

TEST(ErrorPolicy, ALearnerThatRestartedIsJoinedAgain) {
  EXPECT_EQ(ReactionTo(CallKind::kPlay, absl::AbortedError("")), Reaction::kJoinAgain);
}

}  // namespace
}  // namespace craftfleet
