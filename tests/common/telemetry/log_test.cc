#include "common/telemetry/log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

const absl::Time kTime = absl::FromUnixMillis(1'700'000'000'123);

LogOptions Json() {
  LogOptions options;
  options.format = LogFormat::kJson;
  options.program = "craftfleet-actor";
  return options;
}

class LogTest : public testing::Test {
 protected:
  ~LogTest() override { SetUpLog({}); }
};

TEST_F(LogTest, TextLineHasTimeLevelAndText) {
  const std::string line = FormatLogLine({}, LogLevel::kWarning, "it rains", kTime);
  EXPECT_THAT(line, HasSubstr(":20.123 warning: it rains\n"));
  EXPECT_EQ(line.find("warning"), 13);
}

TEST_F(LogTest, JsonLineIsOneObjectWithTheTimeInUtc) {
  EXPECT_EQ(FormatLogLine(Json(), LogLevel::kError, "say \"it\"", kTime),
            R"({"time":"2023-11-14T22:13:20.123Z","level":"error","program":"craftfleet-actor","message":"say \"it\""})"
            "\n");
}

TEST_F(LogTest, ControlCharactersAreEscaped) {
  const std::string text = "name \"a\nb\x1b[2Jc\"";
  const std::string line = FormatLogLine({}, LogLevel::kInfo, text, kTime);
  EXPECT_THAT(line, HasSubstr("name \"a\\nb\\x1b[2Jc\"\n"));
  const std::string json = FormatLogLine(Json(), LogLevel::kInfo, text, kTime);
  EXPECT_EQ(json.find('\n'), json.size() - 1);
  EXPECT_EQ(nlohmann::json::parse(json)["message"], text);
}

TEST_F(LogTest, ControlCharactersOfTwoBytesAreEscaped) {
  const std::string text =
      "a\xc2\x9b"
      "2Jb\x7f\xc2\xa0\xc3\xa4";
  EXPECT_THAT(FormatLogLine({}, LogLevel::kInfo, text + "\xc2", kTime),
              HasSubstr("info: a\\u009b2Jb\\x7f\xc2\xa0\xc3\xa4\xc2\n"));
  const std::string json = FormatLogLine(Json(), LogLevel::kInfo, text, kTime);
  EXPECT_THAT(json, HasSubstr("a\\u009b2Jb\\u007f"));
  EXPECT_EQ(nlohmann::json::parse(json)["message"], text);
}

TEST_F(LogTest, NoLineIsLongerThanAKilobyte) {
  const std::string texts[] = {std::string(1000, 'a'), std::string(1'000'000, 'a'), std::string(1'000'000, '\x01'),
                               std::string(900, '"'), std::string(5000, '\xff')};
  for (const LogOptions& options : {LogOptions(), Json()}) {
    for (const std::string& text : texts) {
      const std::string line = FormatLogLine(options, LogLevel::kWarning, text, kTime);
      EXPECT_LE(line.size(), kMaxLogLineBytes);
      EXPECT_GT(line.size(), kMaxLogLineBytes - 200) << line;  // little is lost
      EXPECT_EQ(line.find('\n'), line.size() - 1);
    }
  }
  EXPECT_THAT(FormatLogLine({}, LogLevel::kInfo, texts[1], kTime), HasSubstr("aaa... (1000000 bytes)\n"));
  EXPECT_TRUE(nlohmann::json::accept(FormatLogLine(Json(), LogLevel::kInfo, texts[2], kTime)));
}

TEST_F(LogTest, ShortenedTextHasItsOriginalLength) {
  EXPECT_EQ(Shortened("short", 32), "short");
  EXPECT_EQ(Shortened(std::string(32, 'x'), 32), std::string(32, 'x'));
  EXPECT_EQ(Shortened(std::string(33, 'x'), 32), std::string(18, 'x') + "... (33 bytes)");
  std::string umlauts;
  for (int i = 0; i < 100; ++i) umlauts += "\xc3\xa4";
  EXPECT_EQ(Shortened(umlauts, 32), umlauts.substr(0, 16) + "... (200 bytes)");  // 17 would cut one
}

TEST_F(LogTest, InvalidUtf8IsReplacedInJson) {
  const auto json = nlohmann::json::parse(FormatLogLine(Json(), LogLevel::kInfo, "\xff\xfe!", kTime));
  EXPECT_THAT(json["message"].get<std::string>(), HasSubstr("!"));
}

TEST_F(LogTest, LinesBelowTheLevelAreNotWrittenButCounted) {
  LogOptions options;
  options.level = LogLevel::kError;
  SetUpLog(options);
  const LogCounts before = CountLogged();
  testing::internal::CaptureStderr();
  LogInfo("quiet");
  LogWarning("quiet %d", 2);
  LogError("loud: %s", "mend it");
  const std::string out = testing::internal::GetCapturedStderr();
  EXPECT_THAT(out, HasSubstr("error: loud: mend it\n"));
  EXPECT_THAT(out, Not(HasSubstr("quiet")));
  const LogCounts after = CountLogged();
  EXPECT_EQ(after.warnings, before.warnings + 1);
  EXPECT_EQ(after.errors, before.errors + 1);
  EXPECT_EQ(after.last_error, "loud: mend it");
}

}  // namespace
}  // namespace craftfleet
