#include "common/wire/access.h"

#include <sys/stat.h>

#include <cstdio>
#include <fstream>
#include <optional>
#include <string>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
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
  client { name: "workers" certificate: "*.workers" right: PLAY }
  client {
    name: "monitor"
    token_sha256: "85d9d230f02e4c3e3e73d2d692f0e10d861e71994736b58a8163cff890d9c938"
    right: WATCH
  }
  client {
    name: "boss"
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
  EXPECT_EQ(RightFor(kStatus), v1::WATCH);
  EXPECT_EQ(RightFor(kJoin), v1::PLAY);
  EXPECT_EQ(RightFor("/craftfleet.v1.LearnerService/SomethingNew"), v1::PLAY);
  EXPECT_EQ(RightFor("/craftfleet.v1.LearnerService/Announce"), v1::SERVE);
  EXPECT_EQ(RightFor("/craftfleet.v1.EnvironmentService/Play"), v1::PLAY);
  EXPECT_EQ(RightFor(kStop), v1::STEER);
  EXPECT_EQ(RightFor("/some.other.Service/Call"), v1::STEER);
  EXPECT_EQ(RightFor(""), v1::STEER);
}

TEST(Access, ACertificateMatchesByAnyOfItsNames) {
  const Caller worker = {{"b7", "actor-1.workers"}, std::nullopt, "craftfleet-actor"};
  EXPECT_THAT(Check(worker, kJoin), IsOk());
  EXPECT_THAT(Check(worker, kStatus), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("the right to watch")));
  EXPECT_THAT(Check(worker, kStop), StatusIs(absl::StatusCode::kPermissionDenied,
                                             AllOf(HasSubstr("craftfleet-actor (certificate b7, actor-1.workers)"),
                                                   HasSubstr("\"workers\""), HasSubstr("the right to steer"))));
}

TEST(Access, ATokenMatchesByItsDigest) {
  const Caller monitor = {{}, "watch me", "curl"};
  EXPECT_THAT(Check(monitor, kStatus), IsOk());
  EXPECT_THAT(Check(monitor, kJoin),
              StatusIs(absl::StatusCode::kPermissionDenied, AllOf(HasSubstr("\"monitor\""), HasSubstr("to play"))));
  EXPECT_THAT(Check({{}, "boss", "curl"}, kStop), IsOk()) << "upper-case digits";
  EXPECT_THAT(Check({{}, "watch mE", "curl"}, kStatus),
              StatusIs(absl::StatusCode::kUnauthenticated,
                       AllOf(HasSubstr("token is not in the access file"), Not(HasSubstr("watch mE")))));
}

TEST(Access, ACertificateThatIsNotListedHasNoRight) {
  EXPECT_THAT(Check({{"desk"}, std::nullopt, ""}, kStop),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("no client with this certificate")));
}

TEST(Access, CallersWithoutCredentialsMayOnlyCheckHealth) {
  EXPECT_THAT(Check({}, kHealth), IsOk());
  EXPECT_THAT(Check({}, kStatus),
              StatusIs(absl::StatusCode::kUnauthenticated, HasSubstr("neither a token nor a certificate")));
}

TEST(Access, TextFromUnknownCallersIsShortenedAndEscaped) {
  const absl::Status status = Check({{"evil\nname"}, std::nullopt, std::string(1000, 'x')}, kStatus);
  EXPECT_THAT(std::string(status.message()), AllOf(HasSubstr("evil\\nname"), Not(HasSubstr("\n"))));
  EXPECT_LT(status.message().size(), 400);
}

TEST(Access, ErrorsInTheFileNameTheProblem) {
  EXPECT_THAT(ParseAccess("\n", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a.txt: it lists no client")));
  EXPECT_THAT(ParseAccess("client { nam: 3 }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("a.txt:1"), HasSubstr("nam"))));
  EXPECT_THAT(ParseAccess("client { certificate: \"x\" right: PLAY }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a.txt: a client has no name")));
  EXPECT_THAT(ParseAccess("client { name: \"x\" right: PLAY }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("neither certificate nor token_sha256")));
  const std::string both = absl::StrCat("certificate: \"x\" token_sha256: \"", std::string(64, 'a'), "\"");
  EXPECT_THAT(ParseAccess(absl::StrCat("client { name: \"x\" ", both, " right: PLAY }"), "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("a.txt: client \"x\" has both certificate and token_sha256, want"))));
  EXPECT_THAT(ParseAccess("client { name: \"x\" token_sha256: \"secret\" right: PLAY }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("6 characters, want 64")));
  EXPECT_THAT(ParseAccess("client { name: \"x\" certificate: \"*\" }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("has no right")));
}

TEST(Access, AnUnknownRightIsRefusedWithTheKnownOnes) {
  EXPECT_THAT(ParseAccess("client { name: \"x\" certificate: \"*\" right: WORK }", "a.txt"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("a.txt:1:"), HasSubstr("known values: WATCH, STEER, PLAY, SERVE"))));
  for (const char* right : {"2", "77", "RIGHT_UNSPECIFIED"}) {
    const std::string text = absl::StrCat("client { name: \"x\" certificate: \"*\" right: ", right, " }");
    EXPECT_THAT(ParseAccess(text, "a.txt"),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want WATCH, PLAY, SERVE or STEER")));
  }
}

TEST(Access, TheRightToServeDoesNotIncludePlay) {
  const auto access = ParseAccess("client { name: \"s\" certificate: \"s\" right: SERVE }", "access.txt");
  ASSERT_THAT(access, IsOk());
  EXPECT_THAT(CheckAccess(*access, {{"s"}, std::nullopt, ""}, "/craftfleet.v1.LearnerService/Announce"), IsOk());
  EXPECT_THAT(CheckAccess(*access, {{"s"}, std::nullopt, ""}, kJoin),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("the right to play")));
}

TEST(AccessControl, HidesReasonsFromCallersAndReloadsItsFile) {
  const TempFolder folder;
  const std::string path = folder / "access.txt";
  ASSERT_THAT(ReplaceFile(path, "client { name: \"a\" certificate: \"a\" right: WATCH }"), IsOk());
  const auto control = AccessControl::Create(path);
  ASSERT_THAT(control, IsOk());
  const Caller a = {{"a"}, std::nullopt, ""};
  EXPECT_THAT((*control)->Check(a, kStatus), IsOk());
  EXPECT_THAT((*control)->Check(a, kJoin), StatusIs(absl::StatusCode::kPermissionDenied,
                                                    "not allowed; the log of the process that was called says why"));

  ASSERT_THAT(ReplaceFile(path, "client { name: \"a\" certificate: \"a\" right: PLAY }"), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return (*control)->Check(a, kJoin).ok(); }));
  EXPECT_FALSE((*control)->Check(a, kStatus).ok());

  for (const char* text : {"nonsense", ""}) {
    ASSERT_THAT(ReplaceFile(path, text), IsOk());
    EXPECT_FALSE(WaitUntil([&] { return !(*control)->Check(a, kJoin).ok(); }, absl::Seconds(2))) << text;
  }
}

TEST(AccessControl, NoCallWaitsForTheFile) {
  const TempFolder folder;
  const std::string path = folder / "access.txt";
  ASSERT_THAT(ReplaceFile(path, "client { name: \"a\" certificate: \"a\" right: WATCH }"), IsOk());
  const auto control = AccessControl::Create(path);
  ASSERT_THAT(control, IsOk());
  // Simulates a hanging disk: opening a FIFO blocks until it has a writer.
  ASSERT_EQ(std::remove(path.c_str()), 0);
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  absl::SleepFor(absl::Seconds(1.5));  // longer than the interval between checks
  const absl::Time begin = absl::Now();
  EXPECT_THAT((*control)->Check({{"a"}, std::nullopt, ""}, kStatus), IsOk());
  EXPECT_LT(absl::Now() - begin, absl::Seconds(5));
  std::ofstream(path) << "client { name: \"b\" certificate: \"b\" right: WATCH }";
  EXPECT_TRUE(WaitUntil([&] { return (*control)->Check({{"b"}, std::nullopt, ""}, kStatus).ok(); }));
}

TEST(AccessControl, CreateFailsWithoutAReadableFile) {
  EXPECT_THAT(AccessControl::Create("/nowhere"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("--access_file: cannot open /nowhere: No such file")));
}

}  // namespace
}  // namespace craftfleet::wire
