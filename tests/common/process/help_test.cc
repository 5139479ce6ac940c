#include "common/process/help.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/process/flag_values.h"
#include "common/process/program.h"

ABSL_FLAG(std::string, colour, "", "which colour the thing has [red]");
ABSL_FLAG(int32_t, weight, 7, "weight in grams, 1..100;\nmore is too heavy for the shelf\n[that of the last one]");
ABSL_FLAG(bool, fragile, false, "handle with care");
ABSL_FLAG(craftfleet::Count, copies, {3}, "how many are made");
ABSL_FLAG(craftfleet::TimeSpan, pause, {absl::Seconds(2)}, "time from one to the next");

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::EndsWith;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

constexpr char kUsage[] = R"(craftfleet make THING... makes things, one after the other. They go to the
shelf.

  craftfleet make spoon)";

// A program with the flags that every program has.
class Help : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    char name[] = "make";
    char* arguments[] = {name, nullptr};
    ParseFlags({"craftfleet make", kUsage}, 1, arguments);
  }
};

ProgramHelp Maker() { return {"craftfleet make", kUsage, {"weight", "copies"}}; }

TEST_F(Help, ShortHelpHasOneLinePerMainFlag) {
  EXPECT_EQ(ShortHelp(Maker()), std::string(kUsage) + R"(

Flags:
  --weight (default 7)  weight in grams, 1..100 [that of the last one]
  --copies (default 3)  how many are made

craftfleet make --helpfull explains all 7 flags in full; --version shows the version.
)");
}

TEST_F(Help, FullHelpHasEveryFlagWithItsWholeText) {
  const std::string help = FullHelp(Maker());
  EXPECT_THAT(help, StartsWith(kUsage));
  EXPECT_THAT(
      help, HasSubstr("\nFlags of craftfleet make:\n"
                      "  --weight (default 7)\n      weight in grams, 1..100;\n      more is too heavy for the shelf\n"
                      "      [that of the last one]\n  --copies (default 3)\n"));
  EXPECT_THAT(help, HasSubstr("\nMore flags:\n  --colour\n      which colour the thing has [red]\n  --fragile"));
  EXPECT_THAT(help, HasSubstr("  --log_level (default info)\n"));
  EXPECT_THAT(help, Not(HasSubstr("flagfile"))) << "absl's own";
}

TEST_F(Help, MainFlagsDefaultToTheProgramsOwn) {
  const std::string help = ShortHelp({"craftfleet make", kUsage, {}});
  EXPECT_THAT(help, HasSubstr("\n  --colour                   which colour"));
  EXPECT_THAT(help, HasSubstr("\n  --fragile (default false)  handle"));
  EXPECT_THAT(help, Not(HasSubstr("--log_level")));
}

TEST_F(Help, ACommandHasOnlyTheFlagsThatItNamesAndExplainsThemItself) {
  const std::string help =
      FullHelp({"craftfleet make", kUsage, {"weight"}, {"copies"}, {{"weight", "of the spoon\n[light]"}}});
  EXPECT_THAT(help,
              HasSubstr("\nFlags of craftfleet make:\n  --weight (default 7)\n      of the spoon\n      [light]\n"));
  EXPECT_THAT(help, HasSubstr("\nMore flags:\n  --copies (default 3)\n"));
  EXPECT_THAT(help, HasSubstr("  --log_level (default info)\n")) << "every program has those of the log";
  EXPECT_THAT(help, Not(HasSubstr("--colour")));
  EXPECT_THAT(FullHelp({"craftfleet make", kUsage, {"weight"}, {"process/help_test.cc"}}), HasSubstr("--colour"));
}

TEST_F(Help, JsonHasUsageAndFlags) {
  const nlohmann::json json = nlohmann::json::parse(HelpJson(Maker()));
  EXPECT_EQ(json["program"], "craftfleet make");
  EXPECT_EQ(json["usage"], kUsage);
  std::vector<std::string> names;
  std::map<std::string, nlohmann::json> flags;
  for (const nlohmann::json& flag : json["flags"]) {
    names.push_back(flag["name"]);
    flags[flag["name"]] = flag;
  }
  EXPECT_THAT(names, ElementsAre("weight", "copies", "colour", "fragile", "log_format", "log_level", "pause"));
  EXPECT_EQ(flags["weight"], nlohmann::json({{"name", "weight"},
                                             {"type", "integer"},
                                             {"default", "7"},
                                             {"help",
                                              "weight in grams, 1..100;\nmore is too heavy for the shelf\n"
                                              "[that of the last one]"},
                                             {"group", "main"}}));
  EXPECT_EQ(flags["copies"]["type"], "integer");
  EXPECT_EQ(flags["colour"]["type"], "string");
  EXPECT_EQ(flags["colour"]["group"], "other");
  EXPECT_EQ(flags["fragile"]["type"], "bool");
  EXPECT_EQ(flags["pause"]["type"], "duration");
  EXPECT_EQ(flags["pause"]["default"], "2s");
}

}  // namespace
}  // namespace craftfleet
