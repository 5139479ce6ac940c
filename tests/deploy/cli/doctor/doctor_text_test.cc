#include "deploy/cli/doctor/doctor_text.h"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace craftfleet {
namespace {

const std::vector<Finding>& Findings() {
  static const auto* const findings =
      new std::vector<Finding>{{"CPU", Verdict::kOk, "fast", ""},
                               {"open files", Verdict::kWarn, "at most 1024", "raise it"},
                               {"BLAS", Verdict::kFail, "libblas", "install another"}};
  return *findings;
}

TEST(DoctorText, EachFindingHasALineAndItsRemedyAnother) {
  EXPECT_EQ(DoctorText(Findings(), /*colour=*/false),
            "ok    CPU         fast\n"
            "warn  open files  at most 1024\n"
            "                  -> raise it\n"
            "FAIL  BLAS        libblas\n"
            "                  -> install another\n");
}

TEST(DoctorText, OnlyTheVerdictHasColour) {
  const std::string text = DoctorText(Findings(), /*colour=*/true);
  EXPECT_EQ(text.substr(0, text.find('\n')), "\033[32mok  \033[0m  CPU         fast");
  EXPECT_NE(text.find("\033[33mwarn\033[0m  open files"), std::string::npos);
  EXPECT_NE(text.find("\033[1;31mFAIL\033[0m  BLAS"), std::string::npos);
}

TEST(DoctorText, ColourIsForTerminalsThatWantIt) {
  EXPECT_TRUE(WantsColour(true, nullptr, "xterm-256color"));
  EXPECT_TRUE(WantsColour(true, "", "xterm-256color"));
  EXPECT_FALSE(WantsColour(true, "1", "xterm-256color"));
  EXPECT_FALSE(WantsColour(true, nullptr, "dumb"));
  EXPECT_FALSE(WantsColour(true, nullptr, nullptr));
  EXPECT_FALSE(WantsColour(false, nullptr, "xterm-256color"));
}

TEST(DoctorJson, HasEveryFindingAndTheOverallResult) {
  const nlohmann::json json = nlohmann::json::parse(DoctorJson(Findings()));
  EXPECT_EQ(json["ok"], false);
  ASSERT_EQ(json["checks"].size(), 3u);
  EXPECT_EQ(
      json["checks"][2],
      nlohmann::json({{"check", "BLAS"}, {"verdict", "fail"}, {"found", "libblas"}, {"remedy", "install another"}}));
  EXPECT_EQ(nlohmann::json::parse(DoctorJson({Findings()[1]}))["ok"], true);
}

TEST(FailedChecks, AreNamed) {
  EXPECT_EQ(FailedChecks(Findings()), "BLAS");
  EXPECT_EQ(FailedChecks({Findings()[0], Findings()[1]}), "");
}

}  // namespace
}  // namespace craftfleet
