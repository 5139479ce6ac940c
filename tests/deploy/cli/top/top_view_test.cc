#include "deploy/cli/top/top_view.h"

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ContainsRegex;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

void AddMetric(const std::string& name, double value, v1::StatusReply* status) {
  v1::Metric* metric = status->add_metrics();
  metric->set_name(name);
  metric->set_value(value);
}

void AddTime(const std::string& activity, double share, google::protobuf::RepeatedPtrField<v1::ActivityTime>* times) {
  v1::ActivityTime* time = times->Add();
  time->set_activity(activity);
  time->set_share(share);
}

v1::Peer* AddPeer(const std::string& role, const std::string& name, double rate, v1::StatusReply* status) {
  v1::Peer* peer = status->add_peers();
  peer->set_role(role);
  peer->set_name(name);
  peer->set_health(v1::Peer::OK);
  peer->set_last_seen_s(0.3);
  v1::ProcessSummary* summary = peer->mutable_summary();
  summary->set_steps_per_second(rate);
  summary->set_lanes(8);
  summary->set_memory_bytes(int64_t{300} << 20);
  summary->set_policy_version(40);
  AddTime("inference", 0.61, summary->mutable_times());
  AddTime("environment", 0.3, summary->mutable_times());
  AddTime("wire", 0.09, summary->mutable_times());
  return peer;
}

v1::StatusReply Fleet() {
  v1::StatusReply status;
  status.set_role("learner");
  status.set_name("host-1-aa");
  status.set_run_id("run-7");
  status.set_uptime_s(3725);
  AddMetric("env_steps", 172032, &status);
  AddMetric("env_steps_goal", 1e6, &status);
  AddMetric("iteration", 42, &status);
  AddMetric("episodes", 900, &status);
  AddMetric("reward", 4.25, &status);
  AddMetric("episode_length", 187, &status);
  AddMetric("crafter_score", 8.5, &status);
  AddMetric("achievements_unlocked", 15, &status);
  AddMetric("checkpoint_age", 70, &status);
  status.mutable_summary()->set_steps_per_second(1000);
  status.mutable_summary()->set_lanes(16);
  status.mutable_summary()->set_policy_version(42);
  AddTime("update", 0.6, status.mutable_summary()->mutable_times());
  AddTime("update", 0.6, status.mutable_fleet()->mutable_times());
  AddTime("inference", 0.4, status.mutable_fleet()->mutable_times());
  status.mutable_fleet()->set_bottleneck("learner");
  status.mutable_fleet()->set_advice("The learner takes 60% of the time: give it more.");
  AddPeer("actor", "host-3-cc", 600, &status);
  AddPeer("actor", "host-2-bb", 400, &status);
  AddPeer("envserver", "host-4-dd", 1000, &status);
  return status;
}

std::vector<std::string> Texts(const std::vector<TextLine>& lines) {
  std::vector<std::string> texts;
  for (const TextLine& line : lines) texts.push_back(line.text);
  return texts;
}

std::string Page(const v1::StatusReply& status, const TopState& state = {}, TopPage page = {}) {
  page.address = "a:1";
  return absl::StrJoin(Texts(DrawTop(status, state, page)), "\n");
}

// Names of the workers in the order in which they are shown.
std::vector<std::string> Order(const v1::StatusReply& status, const TopState& state) {
  std::vector<std::string> names;
  bool table = false;
  for (const std::string& line : Texts(DrawTop(status, state, {80, 0, "a:1", ""}))) {
    if (table && line.rfind("learner", 0) != 0) names.push_back(line.substr(8, line.find(' ', 8) - 8));
    table |= line.rfind("ROLE", 0) == 0;
  }
  return names;
}

TEST(DrawTop, AWholePageFits80Columns) {
  const v1::StatusReply status = Fleet();
  for (const TextLine& line : DrawTop(status, {}, {80, 0, "a:1", ""})) EXPECT_LE(line.text.size(), 80) << line.text;
  EXPECT_THAT(
      Page(status, {}, {80, 0, "", ""}),
      AllOf(HasSubstr("learner a:1  run run-7  up 1h2m"), HasSubstr("172,032/1,000,000 steps 17.2%  1000 steps/s"),
            HasSubstr("13m48s left"), HasSubstr("iteration 42  reward 4.25  length 187  score 8.50"),
            HasSubstr("2 actors  1 server  0 errors  checkpoint 1m10s ago"),
            HasSubstr("time: update 60%  inference 40%"), HasSubstr(status.fleet().advice())));
  EXPECT_THAT(Page(status, {}, {80, 0, "", ""}), AllOf(ContainsRegex("learner host-1-aa +ok +1000 +16 +- "),
                                                       ContainsRegex("actor +host-2-bb +ok +400 +8 +2 +300M"),
                                                       ContainsRegex("server +host-4-dd +ok +1000 .*env 30")));
}

TEST(DrawTop, ShowsNoFiguresBeforeThereAreEpisodes) {
  v1::StatusReply status = Fleet();
  for (v1::Metric& metric : *status.mutable_metrics()) {
    if (metric.name() != "env_steps_goal") metric.set_value(0);
  }
  status.mutable_peers()->RemoveLast();
  EXPECT_THAT(Page(status),
              HasSubstr("\niteration 0  reward -  length -  score -  unlocked 0/22\n2 actors  0 servers  "));
}

TEST(DrawTop, CountsOneInTheSingular) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(0)->mutable_summary()->set_errors(1);
  status.mutable_peers(1)->set_health(v1::Peer::LEFT);
  EXPECT_THAT(Page(status), HasSubstr("\n1 actor  1 server  1 error  checkpoint"));
}

TEST(DrawTop, TheLearnerOfACompleteRunHasEnded) {
  v1::StatusReply status = Fleet();
  status.mutable_fleet()->set_run_state(v1::FleetSummary::COMPLETE);
  const std::string page = Page(status, {}, {80, 24, "", "no news: gone"});
  EXPECT_THAT(page,
              AllOf(ContainsRegex("learner host-1-aa +ended "), Not(HasSubstr("no news")), Not(HasSubstr("LOST"))));
  status.mutable_fleet()->set_run_state(v1::FleetSummary::EVALUATING);
  EXPECT_THAT(Page(status, {}, {80, 24, "", "no news: gone"}),
              AllOf(ContainsRegex("learner host-1-aa +LOST "), HasSubstr("no news: gone")));
}

TEST(DrawTop, MoreColumnsShowMore) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(0)->set_name("a-name-of-more-than-fifteen-letters");
  EXPECT_THAT(Page(status, {}, {80, 0, "", ""}), HasSubstr("actor   a-name-of-more- ok"));
  EXPECT_THAT(Page(status, {}, {120, 0, "", ""}),
              AllOf(HasSubstr("actor   a-name-of-more-than-fifteen-lett ok"), HasSubstr("inf 61 env 30 wire 9")));
}

TEST(DrawTop, NoLineIsWiderThanThePageNorHigher) {
  v1::StatusReply status = Fleet();
  status.mutable_fleet()->set_advice(std::string(30, 'x') + " " + std::string(30, 'y') + " " + std::string(30, 'z'));
  for (int i = 0; i < 100; ++i) AddPeer("actor", absl::StrCat("worker-", i), i, &status);
  for (const int width : {40, 80, 81, 200}) {
    for (const int height : {12, 24, 50}) {
      const std::vector<TextLine> lines = DrawTop(status, {}, {width, height, std::string(300, 'a'), "trouble"});
      EXPECT_EQ(lines.size(), height);
      for (const TextLine& line : lines) EXPECT_LE(line.text.size(), width);
    }
  }
}

TEST(DrawTop, LostWorkersStandOut) {
  v1::StatusReply status = Fleet();
  v1::Peer* lost = status.mutable_peers(2);
  lost->set_health(v1::Peer::LOST);
  lost->mutable_summary()->clear_steps_per_second();
  lost->mutable_summary()->clear_lanes();
  status.mutable_peers(2)->set_last_seen_s(75);
  EXPECT_THAT(Page(status), AllOf(HasSubstr("0 servers (1 lost)"),
                                  ContainsRegex("server +host-4-dd +LOST +0 +0 +- +300M +0 +1m15s")));
  for (const TextLine& line : DrawTop(status, {}, {})) {
    EXPECT_EQ(line.style == TextLine::Style::kBad, line.text.rfind("server", 0) == 0) << line.text;
  }
}

TEST(DrawTop, ASlowServerStandsOut) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(2)->set_health(v1::Peer::SLOW);
  EXPECT_THAT(Page(status),
              AllOf(HasSubstr("2 actors  1 server (1 slow)"), HasSubstr("server  host-4-dd       SLOW ")));
  for (const TextLine& line : DrawTop(status, {}, {})) {
    EXPECT_EQ(line.style == TextLine::Style::kBad, line.text.rfind("server", 0) == 0) << line.text;
  }
}

TEST(DrawTop, AServerThatDoesNotAnswerStandsOut) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(2)->set_health(v1::Peer::NOT_ANSWERING);
  EXPECT_THAT(Page(status),
              AllOf(HasSubstr("2 actors  0 servers (1 not answering)"), ContainsRegex("server +host-4-dd +HANGS")));
  AddPeer("envserver", "host-5-ee", 0, &status)->set_health(v1::Peer::LOST);
  EXPECT_THAT(Page(status), HasSubstr("0 servers (1 lost, 1 not answering)"));
  for (const TextLine& line : DrawTop(status, {}, {})) {
    EXPECT_EQ(line.style == TextLine::Style::kBad, line.text.rfind("server", 0) == 0) << line.text;
  }
}

TEST(DrawTop, ShowsHowToUndrainWorkers) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(0)->set_drain(v1::Peer::DRAINING);
  EXPECT_THAT(Page(status, {}, {80, 0, "", ""}), AllOf(ContainsRegex("actor +host-3-cc +draining +600 +8"),
                                                       ContainsRegex("actor +host-2-bb +ok +400 +8")));
  status.mutable_peers(0)->set_drain(v1::Peer::DRAINED);
  EXPECT_THAT(Page(status, {}, {100, 0, "", ""}),
              AllOf(ContainsRegex(" drained +600 "),
                    HasSubstr("To use host-3-cc again: craftfleet admin --address=a:1 undrain host-3-cc")));
  status.mutable_peers(2)->set_drain(v1::Peer::DRAINED);
  EXPECT_THAT(Page(status, {}, {100, 0, "", ""}),
              HasSubstr("To use 2 drained workers again: craftfleet admin --address=a:1 undrain NAME"));
  // A lost worker can't be used again.
  status.mutable_peers(2)->set_health(v1::Peer::LOST);
  EXPECT_THAT(Page(status, {}, {100, 0, "", ""}), AllOf(HasSubstr(" LOST "), HasSubstr("To use host-3-cc again")));
}

TEST(DrawTop, ShowsTheStateOfARunThatIsNotTraining) {
  v1::StatusReply status = Fleet();
  status.mutable_fleet()->set_run_state(v1::FleetSummary::TRAINING);
  EXPECT_THAT(Page(status), HasSubstr("1000 steps/s  13m48s left\n"));
  status.mutable_fleet()->set_run_state(v1::FleetSummary::PAUSED);
  EXPECT_THAT(Page(status), HasSubstr("1000 steps/s  paused\n"));
  status.mutable_fleet()->set_run_state(v1::FleetSummary::EVALUATING);
  EXPECT_THAT(Page(status), HasSubstr("1000 steps/s  evaluating\n"));
  status.mutable_fleet()->set_run_state(v1::FleetSummary::COMPLETE);
  EXPECT_THAT(Page(status), HasSubstr("1000 steps/s  complete\n"));
}

TEST(DrawTop, SortsByEachColumn) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(0)->mutable_summary()->set_memory_bytes(1);
  status.mutable_peers(1)->mutable_summary()->set_errors(9);
  status.mutable_peers(2)->mutable_summary()->set_lanes(99);
  TopState state;
  EXPECT_THAT(Order(status, state), ElementsAre("host-2-bb", "host-3-cc", "host-4-dd"));
  state.sort = TopColumn::kSteps;
  EXPECT_THAT(Order(status, state), ElementsAre("host-4-dd", "host-3-cc", "host-2-bb"));
  state.reverse = true;
  EXPECT_THAT(Order(status, state), ElementsAre("host-2-bb", "host-3-cc", "host-4-dd"));
  state.reverse = false;
  state.sort = TopColumn::kErrors;
  EXPECT_THAT(Order(status, state), ElementsAre("host-2-bb", "host-3-cc", "host-4-dd"));
  state.sort = TopColumn::kMemory;
  EXPECT_THAT(Order(status, state), ElementsAre("host-2-bb", "host-4-dd", "host-3-cc"));
  state.sort = TopColumn::kLanes;
  EXPECT_THAT(Order(status, state), ElementsAre("host-4-dd", "host-2-bb", "host-3-cc"));
}

TEST(DrawTop, ScrollsAndCountsHiddenWorkers) {
  v1::StatusReply status = Fleet();
  for (int i = 10; i < 40; ++i) AddPeer("actor", absl::StrCat("worker-", i), i, &status);
  TopState state;
  EXPECT_THAT(Page(status, state, {80, 24, "", ""}), AllOf(HasSubstr("... 0 above, 20 below"), HasSubstr("host-2-bb")));
  state.scroll = 5;
  EXPECT_THAT(Page(status, state, {80, 24, "", ""}),
              AllOf(HasSubstr("... 5 above, 15 below"), Not(HasSubstr("host-2-bb"))));
  state.scroll = 1000;
  EXPECT_THAT(Page(status, state, {80, 24, "", ""}), AllOf(HasSubstr("... 20 above, 0 below"), HasSubstr("host-4-dd")));
}

TEST(DrawTop, UntrustedTextCannotMoveTheCursor) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(0)->set_name("a\x1b[2J\nb\xff");
  status.mutable_peers(0)->mutable_summary()->set_last_error("\r\x07oh");
  for (const std::string& line : Texts(DrawTop(status, {}, {}))) {
    for (const char c : line) EXPECT_TRUE(c >= 0x20 && c <= 0x7e) << line;
  }
  EXPECT_THAT(Page(status), HasSubstr("a?[2J?b?"));
}

TEST(DrawTop, ShowsProblemsPauseErrorsAndHelp) {
  v1::StatusReply status = Fleet();
  status.mutable_peers(0)->mutable_summary()->set_last_error("disk full");
  status.mutable_peers(0)->mutable_summary()->set_errors(2);
  EXPECT_THAT(Page(status, {}, {80, 24, "", "no status from the learner: gone"}),
              HasSubstr("\nno status from the learner: gone\n"));
  EXPECT_THAT(Page(status), AllOf(HasSubstr("2 errors"), HasSubstr("last error of host-3-cc: disk full")));
  TopState state;
  state.paused = true;
  EXPECT_THAT(Page(status, state), StartsWith("craftfleet top PAUSED  learner a:1"));
  state.help = true;
  EXPECT_THAT(Page(status, state), HasSubstr("sort by the next"));
}

TEST(DrawTop, ShowsHowOldTheWeightsAreThatPlay) {
  v1::StatusReply status = Fleet();
  EXPECT_THAT(Page(status), Not(HasSubstr("staleness")));
  AddMetric("staleness_min", 0, &status);
  AddMetric("staleness_mean", 0.75, &status);
  AddMetric("staleness_max", 2, &status);
  AddMetric("fragments_dropped", 3, &status);
  EXPECT_THAT(Page(status), HasSubstr("staleness 0 to 2 updates, mean 0.75  3 fragments dropped"));
}

TEST(DrawTop, ShowsTheLearnersGpu) {
  v1::StatusReply status = Fleet();
  EXPECT_THAT(Page(status), Not(HasSubstr("gpu:")));
  status.mutable_summary()->set_gpu("NVIDIA H100");
  status.mutable_summary()->set_gpu_memory_bytes(int64_t{3} << 30);
  status.mutable_summary()->set_gpu_memory_size_bytes(int64_t{80} << 30);
  status.mutable_summary()->set_gpu_utilization(0.87);
  EXPECT_THAT(Page(status), HasSubstr("gpu: NVIDIA H100  87% busy  3.0G of 80.0G"));
}

TEST(DrawTop, AnEmptyStatusIsDrawn) { EXPECT_THAT(Page({}), HasSubstr("time: not known yet")); }

TEST(HandleKeys, EachKeyHasItsEffect) {
  TopState state;
  HandleKeys("s", 10, &state);
  EXPECT_EQ(state.sort, TopColumn::kName);
  HandleKeys("SS", 10, &state);
  EXPECT_EQ(state.sort, TopColumn::kSeen);
  HandleKeys("r", 10, &state);
  EXPECT_TRUE(state.reverse);
  HandleKeys("p", 10, &state);
  EXPECT_TRUE(state.paused);
  HandleKeys(" ", 10, &state);
  EXPECT_FALSE(state.paused);
  HandleKeys("\x1b[B\x1b[B\x1b[6~", 10, &state);
  EXPECT_EQ(state.scroll, 12);
  HandleKeys("\x1b[A\x1b[5~\x1b[5~", 10, &state);
  EXPECT_EQ(state.scroll, 0);
  HandleKeys("xyz\x1b[C\xff", 10, &state);
  EXPECT_FALSE(state.quit);
  HandleKeys("q", 10, &state);
  EXPECT_TRUE(state.quit);
}

TEST(TopColumn, NamesAreReadBack) {
  for (int i = 0; i < kNumTopColumns; ++i) {
    EXPECT_EQ(TopColumnByName(TopColumnName(static_cast<TopColumn>(i))), static_cast<TopColumn>(i));
  }
  EXPECT_EQ(TopColumnByName("colour"), std::nullopt);
}

TEST(RenderAnsi, ClearsTheRestOfEachLineAndOfThePage) {
  EXPECT_EQ(RenderAnsi({{"a", TextLine::Style::kPlain}, {"b", TextLine::Style::kBad}}),
            "\x1b[Ha\x1b[K\r\n\x1b[31mb\x1b[0m\x1b[K\x1b[J");
}

}  // namespace
}  // namespace craftfleet
