#include "deploy/cli/answer.h"

#include <unistd.h>

#include <memory>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/config/known_canary.h"
#include "common/io/files.h"
#include "learner/run/checkpoint_store.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_paths.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using nlohmann::json;
using testing::HasSubstr;

json AnswerTo(const json& question) { return json::parse(Answer(question.dump())); }

TEST(Answer, AConfigurationIsCompletedAndIdentified) {
  const json answer = AnswerTo({{"config", "agent: 'lstm_cnn' ppo { gamma: 0.9 } seed: 7"}});
  EXPECT_EQ(answer["config"]["agent"], "lstm_cnn");
  EXPECT_EQ(answer["config"]["ppo"]["gamma"], 0.9);
  EXPECT_EQ(answer["config"]["ppo"]["clip"], 0.2);
  EXPECT_EQ(answer["settings"]["ppo"]["gamma"], 0.9);
  EXPECT_EQ(answer["defaults"]["ppo"]["gamma"], 0.95);
  EXPECT_EQ(answer["settings"]["fragment_steps"], answer["defaults"]["fragment_steps"]);
  EXPECT_TRUE(answer["settings"]["network"].empty()) << "it follows from the agent";
  EXPECT_EQ(answer["steps_to_train"], 1003520);
  EXPECT_EQ(answer["identity"], AnswerTo({{"config", "agent: 'lstm_cnn' ppo { gamma: 0.9 }"}})["identity"]);
  const json other = AnswerTo({{"config", "agent: 'lstm_cnn' ppo { gamma: 0.9 }"}, {"textures", "8140aa54698876d7"}});
  EXPECT_NE(answer["identity"], other["identity"]);
  EXPECT_EQ(answer["built_in_textures"], true);
  EXPECT_EQ(other["built_in_textures"], false);
}

TEST(Answer, AnInvalidQuestionIsAnError) {
  const auto error = [](const json& question) { return AnswerTo(question)["error"].get<std::string>(); };
  EXPECT_THAT(error({{"config", "seed: 1\nagnet: 'x'"}, {"path", "run/config.txt"}}), HasSubstr("run/config.txt:2:"));
  EXPECT_THAT(error({{"config", "ppo { gamma: 2 }"}, {"path", "f"}}), HasSubstr("f: ppo.gamma is 2, want 0..1"));
  EXPECT_THAT(error({{"config", "env { name: 'tetris' }"}, {"check_envs", true}}), HasSubstr("environment \"tetris\""));
  EXPECT_THAT(error({{"config", "eval { env: 'tetris' }"}, {"check_envs", true}}), HasSubstr("eval.env: "));
  EXPECT_THAT(error({{"textures_in", "/nowhere"}}), HasSubstr("/nowhere"));
  EXPECT_THAT(error({{"what", 1}}), HasSubstr("not a question"));
  EXPECT_THAT(error({{"config", 1}}), HasSubstr("must be string, but is number"));
  EXPECT_THAT(Answer("no JSON"), HasSubstr("not a JSON object"));
}

TEST(Answer, KnowsTexturesAndMachine) {
  EXPECT_EQ(AnswerTo({{"textures_in", SourcePath("envserver/textures")}})["digest"], "3024e54bf17f9958");
  EXPECT_GE(AnswerTo({{"machine", true}})["threads"], 1);
}

// The identity of a run with these settings on top of the defaults.
std::string Identity(const std::string& settings, const std::string& textures = "") {
  return AnswerTo({{"config", settings}, {"textures", textures}})["identity"];
}

TEST(Identity, IgnoresSettingsThatDoNotAffectLearning) {
  for (const char* settings :
       {"seed: 7", "tile: 4", "gradient_shards: 1", "cpu: AVX2", "checkpoint { keep: 9 }", "env { frame_size: 64 }",
        "env { name: 'crafter:numbers=default' }", "eval { env: 'crafter:inventory=on' every_steps: 1000 }"}) {
    EXPECT_EQ(Identity(settings), Identity("")) << settings;
  }
  EXPECT_EQ(Identity("agent: 'oc_ca' network { heads: 8 }"), Identity("agent: 'oc_ca'")) << "the agent's default";
  EXPECT_EQ(Identity("", std::string(kBuiltInTextures)), Identity(""));
}

TEST(Identity, DistinguishesSettingsThatAffectLearning) {
  std::set<std::string> identities = {Identity("")};
  for (const char* settings : {"agent: 'lstm_cnn'", "steps: 2000000", "lanes: 1", "ppo { gamma: 0.9 }",
                               "network { recurrent: true critic: LSTM }", "env { name: 'crafter:inventory=off' }",
                               "eval { env: 'crafter:numbers=easy-x2' }", "ppo { epochs: 8 }", "agent: 'oc_ca'",
                               "agent: 'oc_ca' network { heads: 4 }"}) {
    EXPECT_TRUE(identities.insert(Identity(settings)).second) << settings;
  }
  for (const char* textures : {"8140aa54698876d7", "8140aa54698876d8"}) {
    EXPECT_TRUE(identities.insert(Identity("", textures)).second) << textures;
  }
}

class FolderTest : public testing::Test {
 protected:
  // What is said of a run of 4,000 steps whose newest checkpoint this is.
  bool IsFinished(Checkpoint* checkpoint) {
    EXPECT_THAT(CheckpointStore::Open(folder_ / "checkpoints")->Write(*checkpoint), IsOk());
    checkpoint->state.set_iteration(checkpoint->state.iteration() + 1);
    return Ask()["finished"].get<bool>();
  }
  json Ask() const { return AnswerTo({{"folder", folder_.path()}, {"steps", 4000}}); }

  const TempFolder folder_;
};

TEST_F(FolderTest, TheNewestCheckpointCountsItsSteps) {
  EXPECT_EQ(Ask(), json({{"begun", false}, {"steps", 0}, {"finished", false}}));
  Checkpoint checkpoint = SampleCheckpoint(3);
  checkpoint.state.set_env_steps(3000);
  EXPECT_FALSE(IsFinished(&checkpoint));
  EXPECT_EQ(Ask(), json({{"begun", true}, {"steps", 3000}, {"finished", false}}));
}

// The checkpoint at the end of training, of a learner that was stopped before it had all evaluations.
TEST_F(FolderTest, IsNotFinishedWhileAnEvaluationIsPending) {
  Checkpoint checkpoint = SampleCheckpoint(4);
  checkpoint.state.mutable_config()->mutable_eval()->set_final_episodes(4);
  checkpoint.state.set_env_steps(4000);
  EXPECT_FALSE(IsFinished(&checkpoint)) << "the final evaluation has not begun";

  checkpoint.state.set_final_evaluation_steps(4000);
  v1::PendingEvaluation* pending = checkpoint.state.add_pending();
  pending->set_number(1);
  pending->set_env_steps(4000);
  pending->set_first_episode(1);
  pending->set_episodes(4);
  pending->set_final(true);
  checkpoint.evaluation_weights = {std::make_shared<const std::string>("weights")};
  EXPECT_FALSE(IsFinished(&checkpoint)) << "the final evaluation is pending";

  pending->set_final(false);
  EXPECT_FALSE(IsFinished(&checkpoint)) << "an evaluation of training is pending";

  checkpoint.state.clear_pending();
  checkpoint.evaluation_weights.clear();
  EXPECT_TRUE(IsFinished(&checkpoint));
  EXPECT_EQ(AnswerTo({{"folder", folder_.path()}, {"steps", 4001}})["finished"], false) << "more steps are wanted now";
}

TEST_F(FolderTest, NeedsNoFinalEvaluationIfNoneIsWanted) {
  Checkpoint checkpoint = SampleCheckpoint(4);
  checkpoint.state.mutable_config()->mutable_eval()->set_final_episodes(0);
  checkpoint.state.set_env_steps(4000);
  EXPECT_TRUE(IsFinished(&checkpoint));
}

TEST_F(FolderTest, ARunWhoseCheckpointsAreAwayHasBegun) {
  ASSERT_EQ(::symlink("nowhere", (folder_ / "checkpoints").c_str()), 0);
  EXPECT_THAT(Ask()["error"].get<std::string>(), HasSubstr("cannot list " + folder_ / "checkpoints"));
}

TEST_F(FolderTest, ADamagedCheckpointIsNamed) {
  ASSERT_THAT(CheckpointStore::Open(folder_ / "checkpoints")->Write(SampleCheckpoint(3)), IsOk());
  ASSERT_THAT(WriteFileSynced(folder_ / "checkpoints/iter-00000003/state.pb", "garbage"), IsOk());
  EXPECT_THAT(Ask()["error"].get<std::string>(), HasSubstr(folder_ / "checkpoints/iter-00000003"));
}

}  // namespace
}  // namespace craftfleet
