#include "actor/error_policy.h"

#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

TEST(ErrorPolicy, HasEveryCodeOnce) {
  std::set<absl::StatusCode> codes;
  for (const ErrorRule& rule : ErrorPolicy()) {
    EXPECT_TRUE(codes.insert(rule.code).second) << absl::StatusCodeToString(rule.code);
    EXPECT_FALSE(rule.why.empty());
  }
  for (int code = 1; code <= 16; ++code) EXPECT_EQ(codes.count(static_cast<absl::StatusCode>(code)), 1u) << code;
}

TEST(ErrorPolicy, NoReplyOfAnEnvironmentServerEndsAnActor) {
  for (const ErrorRule& rule : ErrorPolicy()) {
    EXPECT_NE(ReactionTo(CallKind::kSession, absl::Status(rule.code, "")), Reaction::kEnd);
  }
}

TEST(ErrorPolicy, ARefusedTokenIsRetriedExceptAtTheFirstJoin) {
  for (const absl::Status& error : {absl::PermissionDeniedError(""), absl::UnauthenticatedError("")}) {
    EXPECT_EQ(ReactionTo(CallKind::kJoin, error), Reaction::kEnd);
    for (const CallKind called : {CallKind::kPlay, CallKind::kWeights, CallKind::kSnapshot}) {
      EXPECT_EQ(ReactionTo(called, error), Reaction::kRetry);
    }
  }
}

TEST(ErrorPolicy, ALearnerThatRestartedIsJoinedAgain) {
  EXPECT_EQ(ReactionTo(CallKind::kPlay, absl::AbortedError("")), Reaction::kJoinAgain);
}

}  // namespace
}  // namespace craftfleet
