#include "deploy/cli/inspect/answer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_paths.h"

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
  EXPECT_THAT(Answer("no JSON"), HasSubstr("not a JSON object"));
}

TEST(Answer, KnowsFoldersTexturesMachineAndPage) {
  const TempFolder folder;
  EXPECT_EQ(AnswerTo({{"folder", folder.path()}, {"steps", 5}}),
            json({{"begun", false}, {"steps", 0}, {"finished", false}}));
  EXPECT_EQ(AnswerTo({{"textures_in", SourcePath("envserver/textures")}})["digest"], "3024e54bf17f9958");
  EXPECT_GE(AnswerTo({{"machine", true}})["threads"], 1);
  EXPECT_THAT(AnswerTo({{"page", true}})["page"].get<std::string>(), HasSubstr("id=\"report\">null</script>"));
}

}  // namespace
}  // namespace craftfleet
