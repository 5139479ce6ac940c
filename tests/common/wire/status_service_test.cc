#include "common/wire/status_service.h"

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/process/version.h"
#include "common/telemetry/log.h"
#include "common/wire/request_check.h"
#include "common/wire/server.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

using testing::HasSubstr;

class StatusServiceTest : public testing::Test {
 protected:
  // A stream of status replies, cancelled on destruction.
  struct Watch {
    grpc::ClientContext context;
    std::unique_ptr<grpc::ClientReader<v1::StatusReply>> reader;
    v1::StatusReply reply;
    ~Watch() { context.TryCancel(); }
    bool Read() { return reader->Read(&reply); }
  };
  std::unique_ptr<Watch> Start(int interval_ms) {
    auto watch = std::make_unique<Watch>();
    v1::WatchRequest request;
    request.set_interval_ms(interval_ms);
    watch->reader = stub_->WatchStatus(&watch->context, request);
    return watch;
  }
  grpc::StatusCode CodeOf(int interval_ms) {
    const auto watch = Start(interval_ms);
    EXPECT_FALSE(watch->Read());
    return watch->reader->Finish().error_code();
  }

  int asked_ = 0;
  StatusServiceImpl service_{"actor", [this](v1::StatusReply* reply) {
                               reply->set_run_id("run-7");
                               AddMetric("env_steps", ++asked_, reply);
                             }};
  const std::unique_ptr<Server> server_ = *Server::Create({}, {&service_});
  const std::unique_ptr<v1::StatusService::Stub> stub_ = v1::StatusService::NewStub(server_->InProcess().channel);
};

// Half a letter made the message invalid for its receiver.
TEST(FillUsage, ALongErrorIsCutToText) {
  testing::internal::CaptureStderr();
  LogError("%s", std::string(kMaxReasonBytes - 1, 'x') + "\u00e4");
  testing::internal::GetCapturedStderr();
  v1::ProcessSummary summary;
  FillUsage(&summary);
  EXPECT_EQ(summary.last_error(), std::string(kMaxReasonBytes - 1, 'x') + "?");
}

TEST_F(StatusServiceTest, ReportsRoleRunAndMetrics) {
  service_.SetMetricsAddress("http://here/metrics");
  grpc::ClientContext context;
  v1::StatusReply reply;
  ASSERT_TRUE(stub_->GetStatus(&context, {}, &reply).ok());
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

TEST_F(StatusServiceTest, WatchersGetAStatusAtOnceAndThenMore) {
  const auto watch = Start(100);
  for (int i = 1; i <= 3; ++i) {
    ASSERT_TRUE(watch->Read());
    EXPECT_EQ(watch->reply.metrics(0).value(), i);
  }
}

TEST_F(StatusServiceTest, IntervalsOutOfRangeAreRefused) {
  EXPECT_EQ(CodeOf(99), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(CodeOf(60001), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(CodeOf(-1), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(StatusServiceTest, WatchersBeyondTheLimitAreRefusedUntilOneLeaves) {
  std::vector<std::unique_ptr<Watch>> watches;
  for (int i = 0; i < StatusServiceImpl::kMaxWatchers; ++i) {
    watches.push_back(Start(60000));
    ASSERT_TRUE(watches.back()->Read());
  }
  EXPECT_EQ(CodeOf(60000), grpc::StatusCode::RESOURCE_EXHAUSTED);
  watches.clear();
  EXPECT_TRUE(WaitUntil([this] { return Start(60000)->Read(); }));
}

TEST_F(StatusServiceTest, AWatcherDoesNotDelayShutdown) {
  const auto watch = Start(60000);
  ASSERT_TRUE(watch->Read());
  const absl::Time start = absl::Now();
  server_->Stop(absl::Milliseconds(100));
  EXPECT_LT(absl::Now() - start, absl::Seconds(5));
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
