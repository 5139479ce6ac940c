#include "common/wire/access.h"

#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr char kHealth[] = "/grpc.health.v1.Health/Check";
constexpr char kStatus[] = "/craftfleet.v1.StatusService/GetStatus";
constexpr char kJoin[] = "/craftfleet.v1.LearnerService/Join";
constexpr char kStop[] = "/craftfleet.v1.AdminService/Stop";

// Tokens "watch me" and "boss", through sha256sum.
constexpr char kFile[] = R"(
  client { name: "workers" certificate: "*.workers" right: WORK }
  client {
    name: "monitor"
    token_sha256: "85d9d230f02e4c3e3e73d2d692f0e10d861e71994736b58a8163cff890d9c938"
    right: WATCH
  }
  client {
    name: "boss"
    certificate: "desk"
    token_sha256: "A5E7C002443743C5836758C7D1CD8DDEFD9FCF2061DAA0EFAAC683FB99966057"
    right: WATCH  right: STEER
  }
)";

absl::Status Check(const Caller& caller, const char* path) {
  const absl::StatusOr<v1::Access> access = ParseAccess(kFile, "access.txt");
  return access.ok() ? CheckAccess(*access, caller, path) : access.status();
}

TEST(Access, EveryServiceNeedsItsRight) {
  EXPECT_EQ(RightFor(kHealth), v1::RIGHT_UNSPECIFIED);
  EXPECT_EQ(RightFor("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo"), v1::WATCH);
  EXPECT_EQ(RightFor(kStatus), v1::WATCH);
  EXPECT_EQ(RightFor(kJoin), v1::WORK);
  EXPECT_EQ(RightFor("/craftfleet.v1.EnvironmentService/Play"), v1::WORK);
  EXPECT_EQ(RightFor(kStop), v1::STEER);
  EXPECT_EQ(RightFor("/some.other.Service/Call"), v1::STEER);
  EXPECT_EQ(RightFor(""), v1::STEER);
}

TEST(Access, ACertificateIsKnownByAnyOfItsNames) {
  const Caller worker = {{"b7", "actor-1.workers"}, std::nullopt, "craftfleet-actor"};
  EXPECT_THAT(Check(worker, kJoin), IsOk());
  EXPECT_THAT(Check(worker, kStatus), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("the right to watch")));
  EXPECT_THAT(Check(worker, kStop),
              StatusIs(absl::StatusCode::kPermissionDenied,
                       AllOf(HasSubstr("craftfleet-actor (certificate b7, actor-1.workers, no token)"),
                             HasSubstr("\"workers\""), HasSubstr("the right to steer"))));
}

TEST(Access, ATokenIsKnownByItsDigest) {
  const Caller monitor = {{}, "watch me", "curl"};
  EXPECT_THAT(Check(monitor, kStatus), IsOk());
  EXPECT_THAT(Check(monitor, kJoin),
              StatusIs(absl::StatusCode::kPermissionDenied, AllOf(HasSubstr("\"monitor\""), HasSubstr("to work"))));
  EXPECT_THAT(Check({{}, "watch mE", "curl"}, kStatus),
              StatusIs(absl::StatusCode::kUnauthenticated,
                       AllOf(HasSubstr("token is not in the access file"), Not(HasSubstr("watch mE")))));
}

TEST(Access, WhereBothAreWantedOneIsNotEnough) {
  EXPECT_THAT(Check({{"desk"}, "boss", ""}, kStop), IsOk());
  EXPECT_THAT(Check({{"desk"}, std::nullopt, ""}, kStop),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("no client with this certificate")));
  EXPECT_THAT(Check({{"table"}, "boss", ""}, kStop),
              StatusIs(absl::StatusCode::kUnauthenticated, HasSubstr("not with this certificate")));
}

TEST(Access, WhoShowsNothingMayAskForHealthAlone) {
  EXPECT_THAT(Check({}, kHealth), IsOk());
  EXPECT_THAT(Check({}, kStatus), StatusIs(absl::StatusCode::kUnauthenticated, HasSubstr("it shows no token")));
}

TEST(Access, WhatAStrangerSaysIsCutAndEscaped) {
  const absl::Status status = Check({{"evil\nname"}, std::nullopt, std::string(1000, 'x')}, kStatus);
  EXPECT_THAT(std::string(status.message()), AllOf(HasSubstr("evil\\nname"), Not(HasSubstr("\n"))));
  EXPECT_LT(status.message().size(), 400);
}

TEST(Access, MistakesInTheFileAreNamed) {
  EXPECT_THAT(ParseAccess("client { nam: 3 }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("a.txt:1"), HasSubstr("nam"))));
  EXPECT_THAT(ParseAccess("client { certificate: \"x\" right: WORK }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a.txt: a client has no name")));
  EXPECT_THAT(ParseAccess("client { name: \"x\" right: WORK }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("neither certificate nor token_sha256")));
  EXPECT_THAT(ParseAccess("client { name: \"x\" token_sha256: \"secret\" right: WORK }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("6 characters, want 64")));
  EXPECT_THAT(ParseAccess("client { name: \"x\" certificate: \"*\" }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("has no right")));
}

TEST(AccessControl, GivesNoReasonAwayAndFollowsItsFile) {
  const TempFolder folder;
  const std::string path = folder / "access.txt";
  ASSERT_THAT(ReplaceFile(path, "client { name: \"a\" certificate: \"a\" right: WATCH }"), IsOk());
  const auto control = AccessControl::Create(path);
  ASSERT_THAT(control, IsOk());
  const Caller a = {{"a"}, std::nullopt, ""};
  EXPECT_THAT((*control)->Check(a, kStatus), IsOk());
  EXPECT_THAT((*control)->Check(a, kJoin), StatusIs(absl::StatusCode::kPermissionDenied,
                                                    "not allowed; the log of the process that was called says why"));

  ASSERT_THAT(ReplaceFile(path, "client { name: \"a\" certificate: \"a\" right: WORK }"), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return (*control)->Check(a, kJoin).ok(); }));
  EXPECT_FALSE((*control)->Check(a, kStatus).ok());

  ASSERT_THAT(ReplaceFile(path, "nonsense"), IsOk());
  EXPECT_FALSE(WaitUntil([&] { return !(*control)->Check(a, kJoin).ok(); }, absl::Seconds(2)));
}

TEST(AccessControl, WantsAFileThatCanBeRead) {
  EXPECT_THAT(AccessControl::Create("/nowhere"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("--access_file=/nowhere")));
}

}  // namespace
}  // namespace craftfleet::wire
