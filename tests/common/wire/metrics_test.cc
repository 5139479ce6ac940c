#include "common/wire/metrics.h"

#include <prometheus/text_serializer.h>

#include <set>
#include <string>

#include <absl/strings/ascii.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/metric_table.h"
#include "common/wire/status_service.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

std::string Text(const v1::StatusReply& status) {
  return prometheus::TextSerializer().Serialize(ToMetricFamilies(status));
}

TEST(ToMetricFamilies, NamesAndTypesFollowTheTable) {
  v1::StatusReply status;
  status.set_role("learner");
  AddMetric("env_steps", 4096, &status);
  AddMetric("resident_memory", 1e9, &status);
  AddMetric("checkpoint_age", 2.5, &status);
  const std::string text = Text(status);
  EXPECT_THAT(text, AllOf(HasSubstr("# TYPE craftfleet_env_steps_total counter\n"
                                    "craftfleet_env_steps_total{role=\"learner\"} 4096\n"),
                          HasSubstr("# TYPE craftfleet_resident_memory_bytes gauge\n"),
                          HasSubstr("craftfleet_checkpoint_age_seconds{role=\"learner\"} 2.5\n")));
  EXPECT_THAT(text, Not(HasSubstr("craftfleet_workers")));
}

TEST(ToMetricFamilies, TimesHaveTheActivityAsLabel) {
  v1::StatusReply status;
  status.set_role("actor");
  Work total;
  total.times[Activity::kInference] = 30;
  total.times[Activity::kWire] = 10;
  FillWork(total, total, 2, status.mutable_summary());
  const std::string text = Text(status);
  EXPECT_THAT(text, AllOf(HasSubstr("craftfleet_activity_seconds_total{activity=\"inference\",role=\"actor\"} 30\n"),
                          HasSubstr("craftfleet_time_share{activity=\"wire\",role=\"actor\"} 0.25\n"),
                          HasSubstr("craftfleet_threads{role=\"actor\"} 2\n")));
}

TEST(ToMetricFamilies, WorkersAreCountedByRoleAndState) {
  v1::StatusReply status;
  status.set_role("learner");
  status.mutable_fleet()->set_bottleneck("wire");
  for (const v1::Peer::Health health :
       {v1::Peer::OK, v1::Peer::OK, v1::Peer::LOST, v1::Peer::LEFT, v1::Peer::NOT_ANSWERING}) {
    v1::WorkerCount* const count = status.mutable_fleet()->add_workers();
    count->set_role("actor");
    count->set_health(health);
    count->set_number(1);
  }
  const std::string text = Text(status);
  EXPECT_THAT(text,
              AllOf(HasSubstr("craftfleet_workers{worker=\"actor\",state=\"ok\",role=\"learner\"} 2\n"),
                    HasSubstr("craftfleet_workers{worker=\"actor\",state=\"lost\",role=\"learner\"} 1\n"),
                    HasSubstr("craftfleet_workers{worker=\"actor\",state=\"not_answering\",role=\"learner\"} 1\n"),
                    HasSubstr("craftfleet_workers{worker=\"envserver\",state=\"ok\",role=\"learner\"} 0\n"),
                    HasSubstr("craftfleet_fleet_bottleneck{part=\"wire\",role=\"learner\"} 1\n"),
                    HasSubstr("craftfleet_fleet_bottleneck{part=\"learner\",role=\"learner\"} 0\n"),
                    HasSubstr("craftfleet_fleet_time_share{activity=\"update\",role=\"learner\"} 0\n")));
}

TEST(ToMetricFamilies, TextFromPeersIsEscapedInLabels) {
  v1::StatusReply status;
  status.set_role("actor");
  status.set_run_id("a\"b\nc");
  EXPECT_THAT(Text(status), HasSubstr("run_id=\"a\\\"b\\nc\""));
}

TEST(MetricTable, EveryMetricHasAUniqueNameHelpAndAKnownUnit) {
  std::set<std::string> names;
  for (const MetricInfo& metric : MetricTable()) {
    EXPECT_TRUE(names.insert(PrometheusName(metric)).second) << metric.name;
    EXPECT_EQ(FindMetric(metric.name), &metric);
    EXPECT_TRUE(!absl::ascii_islower(metric.help.front()) && metric.help.back() == '.') << metric.name;
    EXPECT_EQ(PrometheusName(metric).find("_total") != std::string::npos, metric.counter) << metric.name;
  }
  EXPECT_EQ(FindMetric("no_such"), nullptr);
}

}  // namespace
}  // namespace craftfleet::wire
