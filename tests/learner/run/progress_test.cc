#include "learner/run/progress.h"

#include <functional>
#include <sstream>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/log.h"
#include "tests/fakes/fake_clock.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

TEST(FormatTimeLeft, UsesTheUnitsThatFit) {
  EXPECT_EQ(FormatTimeLeft(1), "1s");
  EXPECT_EQ(FormatTimeLeft(800), "13m20s");
  EXPECT_EQ(FormatTimeLeft(10'000), "2h46m");
  EXPECT_EQ(FormatTimeLeft(250'000), "2d21h");
}

class ProgressPrinterTest : public testing::Test {
 protected:
  // `columns` of a terminal; 0: it is none.
  ProgressPrinter Make(int columns) {
    const auto width = [columns] { return columns; };
    return ProgressPrinter({columns > 0 ? width : std::function<int()>(), 4000, 10'000, ""}, &out_, &clock_);
  }

  // What was printed since the last call.
  std::string Printed() {
    std::string text = out_.str();
    out_.str("");
    return text;
  }

  FakeClock clock_;
  std::ostringstream out_;
  ScoreBoard score_;
};

TEST_F(ProgressPrinterTest, WithoutATerminalALineEveryTenSecondsTheFirstAfterTwo) {
  ProgressPrinter printer = Make(0);
  clock_.Advance(absl::Seconds(1.9));
  printer.Update(4100, score_);
  EXPECT_EQ(Printed(), "");
  clock_.Advance(absl::Seconds(0.1));
  printer.Update(4200, score_);
  EXPECT_THAT(Printed(), StartsWith("4,200/10,000 steps 42.0% | 100/s, 58s left | "));
  clock_.Advance(absl::Seconds(9.9));
  printer.Update(4300, score_);
  EXPECT_EQ(Printed(), "");
  clock_.Advance(absl::Seconds(0.1));
  printer.Update(4600, score_);
  const std::string line = Printed();
  EXPECT_THAT(line, StartsWith("4,600/10,000 steps 46.0% | 50/s, "));
  EXPECT_EQ(line.back(), '\n');
}

TEST_F(ProgressPrinterTest, BeginsWithTheRunsId) {
  const ProgressPrinter printer({nullptr, 0, 10'000, "20240131-154500-a1b2c3"}, &out_, &clock_);
  EXPECT_EQ(out_.str(), "run 20240131-154500-a1b2c3\n");
}

TEST_F(ProgressPrinterTest, OnATerminalOneLineInPlace) {
  ProgressPrinter printer = Make(120);
  clock_.Advance(absl::Seconds(2));
  printer.Update(4200, score_);
  clock_.Advance(absl::Seconds(0.5));
  printer.Update(4300, score_);
  const std::string text = Printed();
  EXPECT_THAT(text, StartsWith("\r4,200/10,000"));
  EXPECT_THAT(text, HasSubstr("\033[K\r4,300/10,000"));
  EXPECT_EQ(text.find('\n'), std::string::npos);
  printer.Finish(10'000, score_);
  EXPECT_THAT(Printed(), testing::AllOf(StartsWith("\r10,000/10,000 steps 100.0%"), testing::EndsWith("\033[K\n")));
}

TEST_F(ProgressPrinterTest, IsLoggedIfTheLogIsJson) {
  LogOptions json;
  json.format = LogFormat::kJson;
  SetUpLog(json);
  testing::internal::CaptureStderr();
  ProgressPrinter printer({[] { return 20; }, 0, 10'000, "20240131-154500-a1b2c3"}, &out_, &clock_);
  clock_.Advance(absl::Seconds(2));
  printer.Update(4200, score_);
  printer.Finish(10'000, score_);
  SetUpLog({});
  EXPECT_EQ(Printed(), "");
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, HasSubstr("\"message\":\"4,200/10,000 steps 42.0%"));
  EXPECT_THAT(log, HasSubstr("\"message\":\"10,000/10,000 steps 100.0%"));
}

TEST_F(ProgressPrinterTest, FinishAlwaysPrints) {
  ProgressPrinter printer = Make(0);
  printer.Finish(4000, score_);
  EXPECT_EQ(Printed(), "4,000/10,000 steps 40.0% | -/s, - left | reward - len - | score -, 0/22 unlocked\n");
}

TEST_F(ProgressPrinterTest, ShowsSpeedAndScoreWithinTheWidthOfATerminal) {
  ProgressPrinter printer({nullptr, 0, 1'000'000, ""}, &out_, &clock_);
  clock_.Advance(absl::Seconds(10));
  score_.Add(SampleEpisode(100, 3.0));
  printer.Finish(12'288, score_);
  EXPECT_EQ(Printed(),
            "12,288/1,000,000 steps 1.2% | 1229/s, 13m24s left | reward 3.0 len 100 | score 9.05, 11/22 unlocked\n");
  printer.Finish(1'003'520, score_);
  EXPECT_THAT(Printed(), StartsWith("1,003,520/1,000,000 steps 100.0% | 100352/s, 0s left")) << "beyond the total";
}

TEST_F(ProgressPrinterTest, ANarrowTerminalGetsTheFirstPartsThatFit) {
  int columns = 0;
  ProgressPrinter printer({[&columns] { return columns; }, 0, 100'000'000, ""}, &out_, &clock_);
  clock_.Advance(absl::Seconds(1000));
  score_.Add(SampleEpisode(100, 3.0));
  const std::string steps = "12,288,000/100,000,000 steps 12.3%";
  const std::string reward = steps + " | 12288/s, 1h58m left | reward 3.0 len 100";
  const std::string all = reward + " | score 9.05, 11/22 unlocked";
  ASSERT_EQ(all.size(), 106U);
  const std::pair<int, std::string> expected[] = {
      {107, all}, {106, reward + " | score 9.05"}, {80, reward}, {50, steps}, {10, "12,288,00"}, {1, ""}};
  for (const auto& [width, line] : expected) {
    columns = width;
    printer.Finish(12'288'000, score_);
    EXPECT_EQ(Printed(), "\r" + line + "\033[K\n") << width;
  }
}

}  // namespace
}  // namespace craftfleet
