#include "deploy/cli/sweep/experiments.h"

#include <algorithm>
#include <map>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/config/known_canary.h"
#include "deploy/cli/sweep/run_identity.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

const std::string kPaper = SourcePath("deploy/experiments/paper.txt");

constexpr char kAxes[] = R"(
  axes {
    name: "agent"
    choices { name: "a" label: "Agent A" config { agent: "ppo_cnn" } }
    choices { name: "b" config { agent: "ppo_spcnn" } }
  }
  axes {
    name: "gamma"
    choices { name: "gamma=0.5" config { ppo { gamma: 0.5 } } }
    choices { name: "gamma=0.95" config { ppo { gamma: 0.95 } } }
    choices { name: "own" }
  }
  axes { name: "clip" choices { name: "clip=0.1" config { ppo { clip: 0.1 } } } }
)";

absl::StatusOr<std::vector<Experiment>> Parse(const std::string& experiments) {
  return ParseExperiments(kAxes + experiments, "file.txt");
}

std::vector<std::string> Names(const Experiment& experiment) {
  std::vector<std::string> names;
  for (const Cell& cell : experiment.cells) names.push_back(cell.name);
  return names;
}

TEST(ParseExperiments, AProductHasEveryCombinationTheLastAxisFastest) {
  const auto file = Parse(R"(experiments { name: "t" axes { axis: "agent" } axes { axis: "gamma" } })");
  ASSERT_THAT(file, IsOk());
  EXPECT_THAT(Names(file->at(0)),
              ElementsAre("a/gamma=0.5", "a/gamma=0.95", "a/own", "b/gamma=0.5", "b/gamma=0.95", "b/own"));
  const Cell& cell = file->at(0).cells[3];
  EXPECT_EQ(cell.experiment, "t");
  EXPECT_EQ(cell.folder, "t/b/gamma=0.5");
  EXPECT_THAT(cell.choices, ElementsAre(1, 0));
  EXPECT_EQ(cell.config.agent(), "ppo_spcnn");
  EXPECT_EQ(cell.config.ppo().gamma(), 0.5);
  EXPECT_EQ(cell.config.ppo().clip(), DefaultRunConfig().ppo().clip());
}

TEST(ParseExperiments, EachVariesOneAxisAtATime) {
  const auto file = Parse(
      R"(experiments { name: "t" axes { axis: "clip" } axes { axis: "gamma" only: "gamma=0.5" } combine: EACH })");
  ASSERT_THAT(file, IsOk());
  EXPECT_THAT(Names(file->at(0)), ElementsAre("clip=0.1", "gamma=0.5"));
  EXPECT_EQ(file->at(0).cells[1].config.ppo().clip(), 0.2);
  EXPECT_THAT(file->at(0).cells[1].axes, ElementsAre(1));
}

TEST(ParseExperiments, PairsVaryEveryTwoAxes) {
  const auto file = Parse(R"(
    experiments {
      name: "t" axes { axis: "agent" only: "b" } axes { axis: "clip" } axes { axis: "gamma" only: "own" } combine: PAIRS
    })");
  ASSERT_THAT(file, IsOk());
  EXPECT_THAT(Names(file->at(0)), ElementsAre("b/clip=0.1", "b/own", "clip=0.1/own"));
  EXPECT_EQ(file->at(0).cells[2].config.agent(), "ppo_cnn");
}

TEST(ParseExperiments, ChoicesOverrideTheBase) {
  const auto file = Parse(R"(
    experiments { name: "t" base { steps: 5000 ppo { gamma: 0.7 clip: 0.3 } } axes { axis: "gamma" } })");
  ASSERT_THAT(file, IsOk());
  EXPECT_EQ(file->at(0).cells[0].config.ppo().gamma(), 0.5);
  EXPECT_EQ(file->at(0).cells[2].config.ppo().gamma(), 0.7);
  EXPECT_EQ(file->at(0).cells[0].config.ppo().clip(), 0.3);
  EXPECT_EQ(file->at(0).cells[0].config.steps(), 5000);
}

TEST(ParseExperiments, CellsOfOneConfigurationShareTheFirstOnesFolder) {
  const auto file = Parse(R"(
    experiments { name: "t" axes { axis: "agent" } }
    experiments { name: "u" base { agent: "ppo_spcnn" } axes { axis: "gamma" } })");
  ASSERT_THAT(file, IsOk());
  EXPECT_EQ(file->at(1).cells[0].folder, "u/gamma=0.5");
  EXPECT_EQ(file->at(1).cells[1].folder, "t/b");
  EXPECT_EQ(file->at(1).cells[2].folder, "t/b");
}

TEST(ParseExperiments, LabelsAreTheNamesWhereNoneIsGiven) {
  const auto file = Parse(R"(experiments { name: "t" axes { axis: "agent" } })");
  ASSERT_THAT(file, IsOk());
  EXPECT_EQ(file->at(0).axes[0].choices[0].label(), "Agent A");
  EXPECT_EQ(file->at(0).axes[0].choices[1].label(), "b");
  EXPECT_EQ(file->at(0).title, "t");
}

struct BadFile {
  const char* text;
  const char* message;
};
class ParseExperimentsBad : public testing::TestWithParam<BadFile> {};
TEST_P(ParseExperimentsBad, IsRefusedWithThePlace) {
  const absl::Status status = Parse(GetParam().text).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(status.message(), HasSubstr("file.txt:"));
  EXPECT_THAT(status.message(), HasSubstr(GetParam().message));
}
INSTANTIATE_TEST_SUITE_P(
    Files, ParseExperimentsBad,
    testing::Values(
        BadFile{"experiments { nam: \"t\" }", "known fields of Experiment: name, title"},
        BadFile{"experiments { name: \"t\" combine: ALL }", "known values: PRODUCT, EACH, PAIRS)"},
        BadFile{"experiments { name: \"t\" axes { axis: \"x\" } }", "experiment \"t\": axis \"x\" is not in the file"},
        BadFile{"experiments { name: \"t\" axes { axis: \"agent\" only: \"c\" } }",
                "axis \"agent\" has no choice \"c\""},
        BadFile{"experiments { name: \"t\" } experiments { name: \"t\" }", "experiment \"t\" occurs twice"},
        BadFile{"experiments { name: \"../t\" }", "experiment \"../t\": want letters"},
        BadFile{"axes { name: \"x\" }", "no experiment in it"},
        BadFile{"experiments { }", "experiment \"\": want letters"},
        BadFile{"experiments { name: \"t\" base { ppo { gamma: 2 } } }",
                "experiment \"t\": cell \"t\": ppo.gamma is 2"},
        BadFile{"experiments { name: \"t\" base { ppo { gamma: 2 } } axes { axis: \"clip\" } }",
                "cell \"clip=0.1\": ppo.gamma is 2, want 0..1"},
        BadFile{"experiments { name: \"t\" base { env { name: \"tetris\" } } }", "env.name: environment \"tetris\""},
        BadFile{"experiments { name: \"t\" base { eval { env: \"tetris\" } } }", "eval.env: environment \"tetris\""},
        BadFile{"experiments { name: \"t\" milestones: [2, 1] }", "milestones do not ascend"}));

// The configurations of the paper's tables are valid, and there is one for each cell.
TEST(PaperExperiments, HaveACellForEveryNumberOfThePaper) {
  const auto file = LoadExperiments(kPaper);
  ASSERT_THAT(file, IsOk());
  std::map<std::string, size_t> cells;
  for (const Experiment& experiment : *file) cells[experiment.name] = experiment.cells.size();
  const std::map<std::string, size_t> expected = {{"table1", 6},
                                                  {"no_inventory", 2},
                                                  {"asymptotic", 2},
                                                  {"ood_app", 48},
                                                  {"ood_num", 48},
                                                  {"ablation", 21},
                                                  {"sweeps", 35},
                                                  {"heatmaps_atari", 210},
                                                  {"heatmaps_best", 210},
                                                  {"beyond", 3},
                                                  {"critic", 2},
                                                  {"reproduction", 3},
                                                  {"small", 11},
                                                  {"lanes", 3},
                                                  {"no_inventory_300k", 2},
                                                  {"one_iteration", 7},
                                                  {"overlap_300k", 2},
                                                  {"precision_300k", 2}};
  EXPECT_EQ(cells, expected);
}

TEST(PaperExperiments, EvaluateOnAppearancesThatWereRareOrMissingInTraining) {
  const auto file = LoadExperiments(kPaper);
  ASSERT_THAT(file, IsOk());
  for (const Cell& cell : file->at(3).cells) {
    if (cell.config.env().name() == "crafter") continue;
    EXPECT_EQ(cell.config.eval().env(), "crafter:appearance=0/33/33/34") << cell.name;
  }
}

TEST(PaperExperiments, PairwiseCellsAreSquaresOfTheirBase) {
  const auto file = LoadExperiments(kPaper);
  ASSERT_THAT(file, IsOk());
  const Experiment& atari = file->at(7);
  ASSERT_EQ(atari.name, "heatmaps_atari");
  for (const Cell& cell : atari.cells) {
    if (cell.name != "gamma=0.8/lambda=0.5") continue;
    const v1::PpoConfig& ppo = cell.config.ppo();
    EXPECT_EQ(ppo.gamma(), 0.8);
    EXPECT_EQ(ppo.gae_lambda(), 0.5);
    EXPECT_EQ(ppo.epochs(), 10);
    EXPECT_EQ(ppo.minibatch_size(), 64);
    EXPECT_EQ(ppo.rollout_steps(), 1024);
  }
}

// A lane plays the whole rollout, in one fragment if it fits a message: with lambda 0.95 shorter ones would change the
// advantages.
TEST(PaperExperiments, ThePapersSettingIsOneLaneWithALongFragment) {
  const auto file = LoadExperiments(kPaper);
  ASSERT_THAT(file, IsOk());
  int cells = 0;
  for (const Experiment& experiment : *file) {
    for (const Cell& cell : experiment.cells) {
      const bool is_paper_setting =
          experiment.name == "heatmaps_atari" || cell.name == "1x4096" || cell.name == "original_1x4096";
      if (!is_paper_setting) continue;
      ++cells;
      EXPECT_EQ(cell.config.lanes(), 1) << cell.name;
      EXPECT_EQ(cell.config.fragment_steps(), std::min(cell.config.ppo().rollout_steps(), 4096)) << cell.name;
    }
  }
  EXPECT_EQ(cells, 210 + 2);
}

TEST(PaperExperiments, ReproductionUsesBothTextures) {
  const auto file = LoadExperiments(kPaper);
  ASSERT_THAT(file, IsOk());
  std::map<std::string, const Cell*> cells;
  for (const Experiment& experiment : *file) {
    for (const Cell& cell : experiment.cells) cells[experiment.name + "/" + cell.name] = &cell;
  }
  const Cell& ours = *cells["reproduction/ours_16x256"];
  const Cell& original = *cells["reproduction/original_16x256"];
  EXPECT_EQ(ours.folder, "table1/ppo_cnn") << "shares its runs";
  EXPECT_EQ(original.folder, "reproduction/original_16x256");
  EXPECT_EQ(original.texture_digest, "8140aa54698876d7");
  EXPECT_EQ(RunIdentity(original.config), RunIdentity(ours.config));
  EXPECT_TRUE(cells["reproduction/original_1x4096"]->config.ppo().truncation_is_terminal());
  EXPECT_EQ(cells["critic/linear"]->folder, "table1/lstm_cnn");
}

v1::RunConfig Resolved(v1::RunConfig config) { return *ResolveRunConfig(std::move(config)); }

TEST(RunIdentity, IgnoresSettingsThatDoNotAffectLearning) {
  const v1::RunConfig config = Resolved(DefaultRunConfig());
  v1::RunConfig other = config;
  other.set_seed(7);
  other.set_tile(4);
  other.set_gradient_shards(1);
  other.set_cpu(v1::RunConfig::AVX2);
  other.mutable_checkpoint()->set_keep(9);
  other.mutable_env()->set_frame_size(64);
  other.mutable_env()->set_name("crafter:numbers=default");
  other.mutable_eval()->set_env("crafter:inventory=on");
  other.mutable_eval()->set_every_steps(1000);
  EXPECT_EQ(RunIdentity(other), RunIdentity(config));
}

TEST(RunIdentity, AnExplicitDefaultOfTheAgentMakesNoDifference) {
  const v1::RunConfig config = Resolved(DefaultRunConfig("oc_ca").value());
  v1::RunConfig other = config;
  other.mutable_network()->set_heads(8);
  EXPECT_EQ(RunIdentity(other), RunIdentity(config));
  other.mutable_network()->set_heads(4);
  EXPECT_NE(RunIdentity(other), RunIdentity(config));
}

TEST(RunIdentity, DistinguishesSettingsThatAffectLearning) {
  const v1::RunConfig config = Resolved(DefaultRunConfig());
  std::set<std::string> identities = {RunIdentity(config)};
  const auto add = [&](auto change) {
    v1::RunConfig other = config;
    change(&other);
    EXPECT_TRUE(identities.insert(RunIdentity(other)).second) << other.DebugString();
  };
  add([](v1::RunConfig* c) { c->set_agent("lstm_cnn"); });
  add([](v1::RunConfig* c) { c->set_steps(2'000'000); });
  add([](v1::RunConfig* c) { c->set_lanes(1); });
  add([](v1::RunConfig* c) { c->mutable_ppo()->set_gamma(0.9); });
  add([](v1::RunConfig* c) { c->mutable_network()->set_recurrent(true); });
  add([](v1::RunConfig* c) { c->mutable_env()->set_name("crafter:inventory=off"); });
  add([](v1::RunConfig* c) { c->mutable_eval()->set_env("crafter:numbers=easy-x2"); });
  add([](v1::RunConfig* c) { c->mutable_distillation()->set_every_iterations(8); });
}

TEST(RunIdentity, DistinguishesTextures) {
  const v1::RunConfig config = Resolved(DefaultRunConfig());
  EXPECT_EQ(RunIdentity(config, kBuiltInTextures), RunIdentity(config));
  EXPECT_NE(RunIdentity(config, "8140aa54698876d7"), RunIdentity(config));
  EXPECT_NE(RunIdentity(config, "8140aa54698876d7"), RunIdentity(config, "8140aa54698876d8"));
}

}  // namespace
}  // namespace craftfleet
