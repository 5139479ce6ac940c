#include "common/process/version.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(Version, NamesProgramVersionAndRevision) {
  EXPECT_THAT(std::string(ProgramVersion()), testing::MatchesRegex("[0-9]+\\.[0-9]+\\.[0-9]+"));
  EXPECT_THAT(std::string(GitRevision()), testing::MatchesRegex("[0-9a-f]{7,40}(-dirty)?|unknown"));
  EXPECT_EQ(VersionText("craftfleet"),
            "craftfleet " + std::string(ProgramVersion()) + " (" + std::string(GitRevision()) + ")");
}

}  // namespace
}  // namespace craftfleet
