// craftfleet agents, the program.

#include <map>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

class AgentsProgram : public SmallRunTest {};

// Parameter counts: AGENTS.md, section 1. oc_sa has a CLS token of 9,216 parameters more than the published code.
const std::map<std::string, int64_t> kParameters = {
    {"ppo_cnn", 609'970},
    {"lstm_cnn", 1'525'170},
    {"lstm_cnn_published", 1'525'170},
    {"ppo_spcnn", 134'539'730},
    {"lstm_spcnn", 135'454'930},
    {"lstm_spcnn_published", 135'454'930},
    {"oc_sa", 3'069'650 + 9'216},
    {"oc_sa_published", 3'069'650},
    {"oc_ca", 8'779'730},
    {"oc_ca_published", 8'779'730},
    {"ppo_resnet", 3'948'306},
    {"ppo_resnet_published", 3'948'306},
    {"achievement_distillation", 9'234'228},
    {"cnn_distillation", 1'942'228},
    {"grid_distillation", 2'183'732},
};

TEST_F(AgentsProgram, ListsEachAgent) {
  const Ended ended = Run("craftfleet agents", {});
  ASSERT_EQ(ended.exit_code, 0) << ended.err;
  for (const auto& [agent, parameters] : kParameters) EXPECT_THAT(ended.out, HasSubstr(agent));
  EXPECT_THAT(ended.out, HasSubstr("609,970"));
}

TEST_F(AgentsProgram, JsonHasTheSameContent) {
  const Ended ended = Run("craftfleet agents", {"--json"});
  ASSERT_EQ(ended.exit_code, 0) << ended.err;
  std::map<std::string, int64_t> parameters;
  for (const nlohmann::json& agent : nlohmann::json::parse(ended.out)) {
    parameters[agent["agent"]] = agent["parameters"];
    const bool is_object_centric = agent["agent"].get<std::string>().rfind("oc_", 0) == 0;
    EXPECT_EQ(agent["frame_size"], is_object_centric ? 72 : 64) << agent;
    const int state_size = agent["core"] == "-" ? 0 : agent["extractor"] == "RESNET" ? 1024 : 512;
    EXPECT_EQ(agent["state_size"], state_size) << agent;
  }
  EXPECT_EQ(parameters, kParameters);
}

}  // namespace
}  // namespace craftfleet
