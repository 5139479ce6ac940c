// Every golden trace and picture of the reference game, replayed. They need the reference's textures, which are not
// part of this project: without CRAFTFLEET_GOLDEN_DIR the tests are skipped.

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <absl/strings/match.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/cpu_paths.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/trace_replayer.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;

class Golden : public OnEachCpuPath {
 protected:
  void SetUp() override {
    OnEachCpuPath::SetUp();
    const char* folder = std::getenv("CRAFTFLEET_GOLDEN_DIR");
    if (folder == nullptr) GTEST_SKIP() << "CRAFTFLEET_GOLDEN_DIR is not set";
    golden_ = folder;
  }

  std::string Textures(const std::string& set) const { return (golden_ / ".." / "assets" / set).string(); }

  void ReplayAll(const std::string& folder, int num_traces) const {
    const std::string path = (golden_ / "crafter" / folder).string();
    const absl::StatusOr<std::vector<std::string>> names = ListFolder(path);
    ASSERT_THAT(names, IsOk());
    int replayed = 0;
    for (const std::string& name : *names) {
      if (!absl::EndsWith(name, ".jsonl.gz")) continue;
      const bool variants = folder == "ood" || absl::StrContains(name, "scenario-ood");
      const auto report = ReplayTrace(JoinPath(path, name), Textures(variants ? "crafter-ood" : "crafter"));
      ASSERT_THAT(report, IsOk());
      EXPECT_EQ(report->difference, "") << name;
      EXPECT_GT(report->steps, 0) << name;
      ++replayed;
    }
    EXPECT_EQ(replayed, num_traces);
  }

  void ReplayPictures(const std::string& folder, const std::string& textures) const {
    const auto report = ReplayFrames((golden_ / "crafter" / folder / "frames.jsonl").string(), Textures(textures));
    ASSERT_THAT(report, IsOk());
    EXPECT_EQ(report->difference, "");
    EXPECT_GT(report->frames, report->steps);
  }

  fs::path golden_;
};

CRAFTFLEET_ON_EACH_CPU_PATH(Golden);

TEST_P(Golden, PlainGamesReplayFieldByField) { ReplayAll("", 32); }
TEST_P(Golden, FarmsReplayFieldByField) { ReplayAll("farm", 4); }
TEST_P(Golden, AFullLengthEpisodeReplaysFieldByField) { ReplayAll("long", 1); }
TEST_P(Golden, VariantGamesReplayFieldByField) { ReplayAll("ood", 16); }
TEST_P(Golden, StagedSituationsReplayFieldByField) { ReplayAll("scenario", 21); }
TEST_P(Golden, PicturesOfPlainGamesMatch) { ReplayPictures("", "crafter"); }
TEST_P(Golden, PicturesOfFarmsMatch) { ReplayPictures("farm", "crafter"); }
TEST_P(Golden, PicturesOfALongEpisodeMatch) { ReplayPictures("long", "crafter"); }
TEST_P(Golden, PicturesOfVariantGamesMatch) { ReplayPictures("ood", "crafter-ood"); }

}  // namespace
}  // namespace craftfleet
