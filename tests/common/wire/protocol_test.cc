#include "common/wire/protocol.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/grpc_status.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;

absl::Status Check(const Handshake& ours, const Handshake& theirs) {
  return CheckHandshake("learner", ours, "actor", theirs);
}

TEST(Handshake, EqualHandshakesAreCompatible) {
  const Handshake handshake = {kProtocolVersion, "run", "digest"};
  EXPECT_THAT(Check(handshake, handshake), IsOk());
}

TEST(Handshake, EmptyFieldsMatchAnything) {
  EXPECT_THAT(Check({kProtocolVersion, "run", "digest"}, {kProtocolVersion, "", ""}), IsOk());
  EXPECT_THAT(Check({kProtocolVersion, "", ""}, {kProtocolVersion, "run", "digest"}), IsOk());
}

TEST(Handshake, ErrorNamesTheSideToUpgrade) {
  EXPECT_THAT(Check({3, "", ""}, {2, "", ""}),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       "this learner speaks protocol version 3, the actor 2: upgrade the actor"));
  EXPECT_THAT(Check({3, "", ""}, {4, "", ""}),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("upgrade the learner")));
}

TEST(Handshake, NamesBothRuns) {
  EXPECT_THAT(Check({1, "run-a", ""}, {1, "run-b", ""}),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("this learner serves run run-a"), HasSubstr("the actor belongs to run run-b"))));
}

TEST(Handshake, NamesBothTextures) {
  EXPECT_THAT(Check({1, "", "aaaa"}, {1, "", "bbbb"}),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("aaaa"), HasSubstr("bbbb"), HasSubstr("the same --textures"))));
}

TEST(GrpcStatus, EveryCodeSurvivesARoundTrip) {
  for (int code = 1; code <= 16; ++code) {
    const absl::Status status(static_cast<absl::StatusCode>(code), "action 17, want 0..16");
    const grpc::Status sent = ToGrpc(status);
    EXPECT_EQ(static_cast<int>(sent.error_code()), code);
    EXPECT_EQ(sent.error_message(), "action 17, want 0..16");
    const absl::Status received = FromGrpc(sent, "environment server 10.0.0.1:5");
    EXPECT_EQ(received.code(), status.code());
    EXPECT_EQ(received.message(), "environment server 10.0.0.1:5: action 17, want 0..16");
  }
  EXPECT_TRUE(ToGrpc(absl::OkStatus()).ok());
  EXPECT_THAT(FromGrpc(grpc::Status::OK, "x"), IsOk());
}

TEST(GrpcStatus, AnEmptyMessageIsReplaced) {
  EXPECT_THAT(FromGrpc({grpc::StatusCode::UNIMPLEMENTED, ""}, "learner 10.0.0.1:5"),
              StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("learner 10.0.0.1:5: does not know this call")));
  EXPECT_THAT(FromGrpc({grpc::StatusCode::UNAVAILABLE, ""}, "x"),
              StatusIs(absl::StatusCode::kUnavailable, "x: UNAVAILABLE"));
}

// A hostile server's error used to reach the user's terminal as it was, also in craftfleet status and admin.
TEST(GrpcStatus, AMessageIsReceivedAsTextOfABoundedLength) {
  EXPECT_THAT(FromGrpc({grpc::StatusCode::ABORTED, "a\x1b]0;b\x07\xc2\x9b"}, "x"),
              StatusIs(absl::StatusCode::kAborted, "x: a?]0;b???"));
  EXPECT_LT(FromGrpc({grpc::StatusCode::ABORTED, std::string(8000, 'a')}, "x").message().size(), 1100);
}

TEST(Text, IsPrintableAndBounded) {
  EXPECT_THAT(CheckText("client", ""), IsOk());
  EXPECT_THAT(CheckText("client", std::string(kMaxTextBytes, '~')), IsOk());
  EXPECT_THAT(CheckText("client", std::string(513, 'a')),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("client has 513 bytes, want at most 512")));
  EXPECT_THAT(
      CheckText("client", "a\x1b[2Jb\xc3"),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("client is \"a\\x1b[2Jb\\xc3\", want printable ASCII")));
}

}  // namespace
}  // namespace craftfleet::wire
