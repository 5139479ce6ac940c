#include "deploy/cli/report/web_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/deploy/cli/report/sample_runs.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

class WebPageTest : public testing::Test {
 protected:
  // What the page's scripts read.
  nlohmann::json Data() const {
    const std::vector<std::string> folders = {temp_.path()};
    const std::string page = WebPage(FindRuns(folders).value().runs);
    const std::string begin = "id=\"report\">";
    const size_t at = page.find(begin) + begin.size();
    return nlohmann::json::parse(page.substr(at, page.find("</script>", at) - at));
  }

  const TempFolder temp_;
};

TEST_F(WebPageTest, HasWhatTheFilesOfEachRunSay) {
  WriteSampleRun(temp_ / "sweep/a/seed1", 1, "", 40, 3);
  WriteSampleRun(temp_ / "sweep/b/seed2", 2, "agent: \"lstm_cnn\"", 20, 22);
  const nlohmann::json runs = Data()["runs"];
  ASSERT_EQ(runs.size(), 2U);
  EXPECT_EQ(runs[0]["name"], "a/seed1");
  EXPECT_EQ(runs[0]["agent"], "ppo_cnn");
  EXPECT_EQ(runs[0]["complete"], true);
  EXPECT_EQ(runs[0]["steps"], 4000);
  EXPECT_EQ(runs[0]["unlocked"], 3);
  EXPECT_EQ(runs[0]["evaluation"], nullptr);
  EXPECT_EQ(runs[0]["rates"]["collect_drink"], 100);
  EXPECT_EQ(runs[0]["rates"]["wake_up"], 0);
  EXPECT_EQ(runs[0]["curve"]["steps"].size(), 40U);
  EXPECT_EQ(runs[1]["name"], "b/seed2");
  EXPECT_EQ(runs[1]["complete"], false);
  EXPECT_NEAR(runs[1]["score"].get<double>(), 100, 1e-9);
}

TEST_F(WebPageTest, CurvesOfLongRunsAreThinned) {
  WriteSampleRun(temp_ / "long", 1, "steps: 200000", 2000, 1);
  const nlohmann::json curve = Data()["runs"][0]["curve"];
  EXPECT_LE(curve["steps"].size(), 512U);
  EXPECT_EQ(curve["steps"].back(), 200000);
}

TEST_F(WebPageTest, NamesOfFoldersCannotEndTheScript) {
  WriteSampleRun(temp_ / "</script><script>alert(1)</script>/run", 1, "", 40, 3);
  const std::vector<std::string> folders = {temp_.path()};
  EXPECT_THAT(WebPage(FindRuns(folders).value().runs), Not(HasSubstr("<script>alert(1)")));
  EXPECT_THAT(Data()["runs"][0]["name"].get<std::string>(), HasSubstr("</script><script>alert(1)</script>/run"));
}

}  // namespace
}  // namespace craftfleet
