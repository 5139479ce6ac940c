#include "deploy/cli/envs/census.h"

#include <set>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/env_name.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

std::string ToOneDecimal(const ObjectCounts& counts) {
  return absl::StrJoin(counts, " ", [](std::string* out, double count) { absl::StrAppendFormat(out, "%.1f", count); });
}

// Source: measured with the published environment.
TEST(CountObjects, GivesThePublishedEnvironmentsCountsOver300Worlds) {
  const std::pair<const char*, const char*> expected[] = {
      {"crafter:numbers=easy-x4", "761.7 208.0 103.0 3.1 2.1"},
      {"crafter:numbers=easy-x2", "380.3 104.0 46.0 6.2 4.4"},
      {"crafter", "189.8 51.9 26.1 14.6 9.7"},
      {"crafter:numbers=hard-x2", "94.5 27.8 13.0 32.5 19.0"},
      {"crafter:numbers=hard-x4", "51.7 13.0 6.1 89.1 37.9"},
      {"crafter:numbers=mix", "761.7 208.0 103.2 60.2 37.9"},
  };
  for (const auto& [env, counts] : expected) {
    const auto counted = CountObjects(env, 300);
    ASSERT_THAT(counted, IsOk());
    EXPECT_EQ(ToOneDecimal(*counted), counts) << env;
  }
}

TEST(CountObjects, NoInventoryHasTheSameWorlds) {
  EXPECT_EQ(*CountObjects("crafter:inventory=off", 20), *CountObjects("crafter", 20));
}

TEST(CountObjects, RefusesUnknownEnvironmentsAndNoWorlds) {
  EXPECT_THAT(CountObjects("craft", 1).status().message(), HasSubstr("unknown game \"craft\""));
  EXPECT_THAT(CountObjects("crafter", 0).status().message(), HasSubstr("worlds is 0, want 1..100000"));
}

TEST(KnownEnvs, EachHasItsCanonicalNameOnce) {
  std::set<std::string> names;
  for (const KnownEnv& env : KnownEnvs()) {
    const auto name = EnvName::Parse(env.name);
    ASSERT_THAT(name, IsOk());
    EXPECT_EQ(name->ToString(), env.name);
    names.insert(env.name);
  }
  EXPECT_EQ(names.size(), KnownEnvs().size());
}

}  // namespace
}  // namespace craftfleet
