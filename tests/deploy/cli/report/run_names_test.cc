#include "deploy/cli/report/run_names.h"

#include <list>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;

class NameGroupsTest : public testing::Test {
 protected:
  // Adds a group of complete runs.
  void Add(const std::vector<std::string>& folders, const std::string& config = "") {
    RunGroup& group = groups_.emplace_back();
    for (const std::string& folder : folders) {
      RunRecord& run = runs_.emplace_back();
      run.folder = folder;
      run.config = ResolveRunConfig(ParseRunConfig(config, "test").value()).value();
      group.complete.push_back(&run);
    }
  }
  std::vector<RunName> Names() const {
    std::vector<const RunGroup*> groups;
    for (const RunGroup& group : groups_) groups.push_back(&group);
    return NameGroups(groups);
  }
  std::vector<std::string> Labels() const {
    std::vector<std::string> labels;
    for (const RunName& name : Names()) labels.push_back(name.label);
    return labels;
  }
  std::vector<std::string> Folders() const {
    std::vector<std::string> folders;
    for (const RunName& name : Names()) folders.push_back(name.folder);
    return folders;
  }

  std::list<RunRecord> runs_;
  std::list<RunGroup> groups_;
};

TEST_F(NameGroupsTest, RunsSideBySideHaveTheNamesOfTheirFolders) {
  Add({"runs/first"}, "steps: 5000");
  Add({"runs/second"}, "steps: 9000");
  EXPECT_THAT(Folders(), ElementsAre("runs/first", "runs/second"));
  EXPECT_THAT(Labels(), ElementsAre("first (ppo_cnn, steps=5000)", "second (ppo_cnn, steps=9000)"));
}

TEST_F(NameGroupsTest, SeedsHaveTheNameOfTheirCommonFolder) {
  Add({"runs/wide/seed1", "runs/wide/seed2"}, "lanes: 32");
  Add({"runs/narrow/seed1"}, "lanes: 8");
  EXPECT_THAT(Folders(), ElementsAre("runs/wide", "runs/narrow"));
  EXPECT_THAT(Labels(), ElementsAre("wide (ppo_cnn, lanes=32)", "narrow (ppo_cnn, lanes=8)"));
}

TEST_F(NameGroupsTest, SeedsBesideOtherRunsAreAPattern) {
  Add({"runs/wide-1", "runs/wide-2"}, "lanes: 32");
  Add({"runs/base-1", "runs/base-2"});
  EXPECT_THAT(Folders(), ElementsAre("runs/wide-*", "runs/base-*"));
  EXPECT_THAT(Labels(), ElementsAre("wide-* (ppo_cnn, lanes=32)", "base-* (ppo_cnn)"));
}

TEST_F(NameGroupsTest, MatchNoOtherRun) {
  Add({"runs/a1", "runs/a3"}, "lanes: 32");
  Add({"runs/a2"});
  EXPECT_THAT(Folders(), ElementsAre("runs/a1 and 1 more", "runs/a2"));
}

TEST_F(NameGroupsTest, AnEnclosingRunKeepsItsOwnFolder) {
  Add({"runs"}, "lanes: 32");
  Add({"runs/seed1"});
  EXPECT_THAT(Folders(), ElementsAre("runs", "runs/seed1"));
}

TEST_F(NameGroupsTest, DetailsAreWhatIsNeitherTheAgentsDefaultNorUsual) {
  Add({"r/a"}, "steps: 5000");
  Add({"r/b"}, "steps: 5000 agent: 'oc_sa' env { name: 'crafter:numbers=easy-x2' }");
  Add({"r/c"}, "steps: 5000 env { name: 'crafter:numbers=easy-x2' } eval { env: 'crafter' } seed: 7");
  Add({"r/d"}, "steps: 5000 ppo { gamma: 0.9 learning_rate: 0.001 epochs: 2 clip: 0.3 gae_lambda: 0.9 }");
  EXPECT_THAT(Labels(), ElementsAre("a (ppo_cnn)", "b (oc_sa, env=crafter:numbers=easy-x2)",
                                    "c (ppo_cnn, env=crafter:numbers=easy-x2, eval.env=crafter)",
                                    "d (ppo_cnn, clip=0.3, epochs=2, gae_lambda=0.9, 2 more)"));
}

TEST_F(NameGroupsTest, ASingleGroupNeedsNoDetails) {
  Add({"mine/seed1"}, "ppo { gamma: 0.123 }");
  EXPECT_THAT(Labels(), ElementsAre("mine (ppo_cnn)"));
  EXPECT_TRUE(NameGroups({}).empty());
}

}  // namespace
}  // namespace craftfleet
