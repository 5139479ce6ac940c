#include "common/wire/status_service.h"

#include <algorithm>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/process/version.h"
#include "common/telemetry/log.h"
#include "common/wire/request_check.h"
#include "common/wire/server.h"

namespace craftfleet::wire {
namespace {

using testing::HasSubstr;

// Half a letter made the message invalid for its receiver.
TEST(FillUsage, ALongErrorIsCutToText) {
  testing::internal::CaptureStderr();
  LogError("%s", std::string(kMaxReasonBytes - 1, 'x') + "\u00e4");
  testing::internal::GetCapturedStderr();
  v1::ProcessSummary summary;
  FillUsage(&summary);
  EXPECT_EQ(summary.last_error(), std::string(kMaxReasonBytes - 1, 'x') + "?");
}

TEST(StatusService, ReportsRoleRunAndMetrics) {
  StatusServiceImpl service("actor", [](v1::StatusReply* reply) {
    reply->set_run_id("run-7");
    AddMetric("env_steps", 1, reply);
  });
  const auto server = *Server::Create({}, {&service});
  service.SetMetricsAddress("http://here/metrics");
  grpc::ClientContext context;
  v1::StatusReply reply;
  ASSERT_TRUE(v1::StatusService::NewStub(server->InProcess().channel)->GetStatus(&context, {}, &reply).ok());
  EXPECT_EQ(reply.role(), "actor");
  EXPECT_THAT(reply.version(), HasSubstr(std::string(ProgramVersion())));
  EXPECT_EQ(reply.run_id(), "run-7");
  EXPECT_EQ(reply.metrics_address(), "http://here/metrics");
  EXPECT_GE(reply.uptime_s(), 0);
  ASSERT_GT(reply.metrics_size(), 5);
  EXPECT_EQ(reply.metrics(0).name(), "env_steps");
  EXPECT_EQ(reply.metrics(0).value(), 1);
  EXPECT_EQ(reply.metrics(0).unit(), "steps");
  EXPECT_TRUE(reply.metrics(0).counter());
}

TEST(StatusService, OnlyThoseThatHaveAPolicyReportItsVersion) {
  for (const char* role : {"learner", "actor", "envserver", "rank"}) {
    const v1::StatusReply reply = StatusServiceImpl(role, [](v1::StatusReply* /*reply*/) {}).Snapshot();
    const bool reports_it = std::any_of(reply.metrics().begin(), reply.metrics().end(),
                                        [](const v1::Metric& metric) { return metric.name() == "policy_version"; });
    EXPECT_EQ(reports_it, role == std::string("learner") || role == std::string("actor")) << role;
  }
}

TEST(FillWork, TimesOfReturnsWhatWasFilled) {
  Work total;
  total.times[Activity::kEnvironment] = 30;
  Work recent;
  recent.times[Activity::kEnvironment] = 3;
  recent.times[Activity::kIdle] = 1;
  recent.per_second = 77;
  total.times[Activity::kIdle] = 10;
  v1::ProcessSummary summary;
  FillWork(total, recent, 4, &summary);
  EXPECT_EQ(summary.steps_per_second(), 77);
  EXPECT_DOUBLE_EQ(TimesOf(summary)[Activity::kEnvironment], 3);
  EXPECT_DOUBLE_EQ(TimesOf(summary)[Activity::kIdle], 1);
  EXPECT_DOUBLE_EQ(summary.times(0).seconds(), 30);
}

}  // namespace
}  // namespace craftfleet::wire
