#include "common/config/env_name.h"

#include <string>
#include <utility>

#include <gmock/gmock.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

TEST(EnvName, PlainCrafterHasTheDefaults) {
  const auto name = EnvName::Parse("crafter");
  ASSERT_THAT(name, IsOk());
  EXPECT_FALSE(name->appearance);
  EXPECT_EQ(name->numbers, "sssss");
  EXPECT_TRUE(name->inventory);
  EXPECT_EQ(name->ToString(), "crafter");
}

TEST(EnvName, ParsesOptionsInAnyOrder) {
  const auto name = EnvName::Parse("crafter:inventory=off,appearance=52/16/16/16,numbers=mix");
  ASSERT_THAT(name, IsOk());
  EXPECT_TRUE(name->appearance);
  EXPECT_THAT(name->percentages, ElementsAre(52, 16, 16, 16));
  EXPECT_EQ(name->numbers, "fffff");
  EXPECT_FALSE(name->inventory);
}

TEST(EnvName, NamedNumberSettingsMatchThePaper) {
  const std::pair<const char*, const char*> settings[] = {{"default", "sssss"}, {"easy-x2", "dddhh"},
                                                          {"easy-x4", "fffqq"}, {"mix", "fffff"},
                                                          {"hard-x2", "hhhdd"}, {"hard-x4", "qqqff"}};
  for (const auto& [setting, letters] : settings) {
    const auto name = EnvName::Parse(std::string("crafter:numbers=") + setting);
    ASSERT_THAT(name, IsOk());
    EXPECT_EQ(name->numbers, letters);
  }
}

TEST(EnvName, ToStringIsCanonicalAndParsesBack) {
  const std::pair<const char*, const char*> names[] = {
      {"crafter:numbers=default", "crafter"},
      {"crafter:inventory=on", "crafter"},
      {"crafter:numbers=dddhh", "crafter:numbers=easy-x2"},
      {"crafter:numbers=qhsdf", "crafter:numbers=qhsdf"},
      {"crafter:appearance=100/0/0/0", "crafter:appearance=100/0/0/0"},
      {"crafter:inventory=off,numbers=mix,appearance=0/33/33/34",
       "crafter:appearance=0/33/33/34,numbers=mix,inventory=off"},
  };
  for (const auto& [given, canonical] : names) {
    const auto name = EnvName::Parse(given);
    ASSERT_THAT(name, IsOk());
    EXPECT_EQ(name->ToString(), canonical);
    EXPECT_EQ(EnvName::Parse(name->ToString())->ToString(), canonical);
  }
}

TEST(EnvName, ErrorsNameTheBadPartAndWhatIsAllowed) {
  const std::pair<const char*, const char*> refusals[] = {
      {"atari", "unknown game \"atari\", want \"crafter\""},
      {"", "unknown game \"\""},
      {"crafter:", "unknown option \"\""},
      {"crafter:color=red",
       "unknown option \"color=red\", want one of appearance=A/B/C/D (percentages of the four variants, sum 100), "
       "numbers=SETTING, inventory=on|off"},
      {"crafter:numbers=easy-x3", "numbers \"easy-x3\", want one of default, easy-x2"},
      {"crafter:numbers=ssssx", "numbers \"ssssx\""},
      {"crafter:numbers=ssss", "numbers \"ssss\""},
      {"crafter:appearance=25/25/25", "appearance \"25/25/25\", want four whole percentages that sum to 100"},
      {"crafter:appearance=25/25/25/26", "sum to 100"},
      {"crafter:appearance=-1/1/50/50", "want four whole percentages"},
      {"crafter:appearance=a/0/0/100", "want four whole percentages"},
      {"crafter:inventory=no", "inventory \"no\", want on or off"},
      {"crafter:numbers=mix,numbers=mix", "option \"numbers\" is given twice"},
      {"crafter:numbers=mix,", "unknown option \"\""},
  };
  for (const auto& [given, message] : refusals) {
    EXPECT_THAT(EnvName::Parse(given),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr(std::string("environment \"") + given + "\""), HasSubstr(message))));
  }
}

}  // namespace
}  // namespace craftfleet
