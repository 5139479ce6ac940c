// EnvServiceImpl: whose run it serves.
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/clock.h"
#include "envserver/env_service.h"
#include "tests/envserver/test_session.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// An idle session of another run used to keep out the actors of the run that the server is registered with.
TEST_F(EnvServiceTest, ARegisteredServerServesItsOwnRunWhateverOthersClaim) {
  Session squatter(server());
  ASSERT_THAT(squatter.Send(Hello("run-b")), IsOk());
  service_->SetRun("run-a");
  Session session(server());
  EXPECT_THAT(session.Send(Hello("run-a")), IsOk());
  EXPECT_THAT(Session(server()).Send(Hello("run-b")),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("serves run run-a")));
}

TEST_F(EnvServiceTest, AnotherRunIsRefusedUntilTheFirstHasLeft) {
  auto first = std::make_unique<Session>(server());
  ASSERT_THAT(first->Send(Hello("run-a")), IsOk());
  EXPECT_THAT(Session(server()).Send(Hello("run-b")),
              StatusIs(absl::StatusCode::kResourceExhausted, AllOf(HasSubstr("run-a"), HasSubstr("run-b"))));
  first->Leave();
  EXPECT_THAT(Session(server()).Send(Hello("run-b")), IsOk());
}

// An evaluation's session belongs to no run; it must not let two runs in.
TEST_F(EnvServiceTest, BesideASessionWithoutRunOneRunIsAdmitted) {
  Session evaluation(server());
  ASSERT_THAT(evaluation.Send(Hello("")), IsOk());
  Session first(server());
  ASSERT_THAT(first.Send(Hello("run-a")), IsOk());
  EXPECT_THAT(Session(server()).Send(Hello("run-b")),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("run-a")));
  EXPECT_THAT(Session(server()).Send(Hello("")), IsOk());
  first.Leave();
  EXPECT_THAT(Session(server()).Send(Hello("run-b")), IsOk());
}

TEST_F(EnvServiceTest, OneOfTwoConcurrentRunsIsRefused) {
  for (int round = 0; round < 20; ++round) {
    Session a(server());
    Session b(server());
    absl::StatusOr<v1::PlayReply> answer_a;
    std::thread thread([&] { answer_a = a.Send(Hello("run-a")); });
    const absl::StatusOr<v1::PlayReply> answer_b = b.Send(Hello("run-b"));
    thread.join();
    EXPECT_NE(answer_a.ok(), answer_b.ok());
    (answer_a.ok() ? a : b).Leave();
  }
}

// Each session of a client that alternates between two runs used to be a line of the log.
TEST_F(EnvServiceTest, ChangesOfTheRunDoNotFillTheLog) {
  testing::internal::CaptureStderr();
  const absl::Time start = SteadyNow();
  for (int i = 0; i < 8; ++i) {
    Session session(server());
    EXPECT_THAT(session.Send(Hello(i % 2 == 0 ? "run-a" : "run-b")), IsOk());
    session.Leave();
  }
  const std::string log = testing::internal::GetCapturedStderr();
  const std::vector<std::string> parts = absl::StrSplit(log, "serves run");
  EXPECT_GT(parts.size(), 1) << log;
  EXPECT_LE(parts.size() - 1, 1 + (SteadyNow() - start) / absl::Seconds(10)) << log;
}

}  // namespace
}  // namespace craftfleet
