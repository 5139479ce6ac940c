#include "deploy/cli/status_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

v1::StatusReply Status() {
  v1::StatusReply reply;
  reply.set_role("learner");
  reply.set_name("host-12-ab");
  v1::Metric* metric = reply.add_metrics();
  metric->set_name("env_steps");
  metric->set_value(12288);
  metric->set_unit("steps");
  v1::ActivityTime* time = reply.mutable_summary()->add_times();
  time->set_activity("update");
  time->set_seconds(90);
  time->set_share(0.875);
  reply.mutable_summary()->set_threads(1);
  v1::Peer* peer = reply.add_peers();
  peer->set_role("actor");
  peer->set_name("host-13-cd");
  peer->set_health(v1::Peer::LOST);
  peer->mutable_summary()->set_lanes(16);
  return reply;
}

TEST(StatusText, HasALineForEachField) {
  const std::string text = StatusText(Status());
  EXPECT_THAT(text, HasSubstr("role                     learner\n"));
  EXPECT_THAT(text, HasSubstr("run                      -\n"));
  EXPECT_THAT(text, HasSubstr("env_steps                12288 steps\n"));
  EXPECT_THAT(text, HasSubstr("  update                  87.5 %         90.0 s since the start\n"));
  EXPECT_THAT(text,
              HasSubstr("  actor      host-13-cd                                          LOST   0 steps/s, 16 lanes"));
  EXPECT_THAT(text, Not(HasSubstr("bottleneck")));
}

TEST(StatusText, WholeNumbersAreExact) {
  v1::StatusReply reply = Status();
  const auto set = [&](double value) { reply.mutable_metrics(0)->set_value(value); };
  set(123456789012345);
  EXPECT_THAT(StatusText(reply), HasSubstr(" 123456789012345 steps\n"));
  set(-0.25);
  EXPECT_THAT(StatusText(reply), HasSubstr(" -0.25 steps\n"));
  set(1e300);
  EXPECT_THAT(StatusText(reply), HasSubstr(" 1e+300 steps\n"));
}

TEST(StatusText, SaysHowManyWorkersItDoesNotList) {
  v1::StatusReply reply = Status();
  v1::WorkerCount* const count = reply.mutable_fleet()->add_workers();
  count->set_role("actor");
  count->set_number(reply.peers_size());
  EXPECT_THAT(StatusText(reply), Not(HasSubstr("more workers")));
  count->set_number(reply.peers_size() + 1200);
  EXPECT_THAT(StatusText(reply), HasSubstr("  and 1200 more workers\n"));
}

TEST(StatusText, ShowsTheStateOfWorkers) {
  v1::StatusReply reply = Status();
  v1::Peer* peer = reply.mutable_peers(0);
  peer->set_health(v1::Peer::NOT_ANSWERING);
  EXPECT_THAT(StatusText(reply), HasSubstr(" NOT ANSWERING "));
  peer->set_health(v1::Peer::SLOW);
  EXPECT_THAT(StatusText(reply), HasSubstr(" SLOW "));
  peer->set_health(v1::Peer::OK);
  peer->set_drain(v1::Peer::DRAINING);
  EXPECT_THAT(StatusText(reply), HasSubstr(" draining "));
  peer->set_drain(v1::Peer::DRAINED);
  EXPECT_THAT(StatusText(reply), HasSubstr(" drained "));
  EXPECT_THAT(StatusText(reply), HasSubstr("craftfleet admin undrain NAME"));
  peer->clear_drain();
  EXPECT_THAT(StatusText(reply), Not(HasSubstr("undrain")));
}

TEST(StatusText, ShowsThatTheFinalEvaluationIsRunning) {
  v1::StatusReply reply = Status();
  EXPECT_THAT(StatusText(reply), Not(HasSubstr("state  ")));
  reply.mutable_fleet()->set_run_state(v1::FleetSummary::EVALUATING);
  EXPECT_THAT(StatusText(reply), HasSubstr("state                    evaluating\n"));
}

TEST(StatusText, UntrustedTextCanNeitherMoveTheCursorNorAddALine) {
  v1::StatusReply reply = Status();
  reply.mutable_summary()->set_last_error("\x1b[2Joh\nrole   actor");
  EXPECT_THAT(StatusText(reply), HasSubstr("last error               ?[2Joh?role   actor\n"));
}

}  // namespace
}  // namespace craftfleet
