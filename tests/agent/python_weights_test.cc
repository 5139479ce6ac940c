// A checkpoint's weights as read by Python.

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/weights.h"
#include "common/io/files.h"
#include "tests/agent/golden_agent.h"
#include "tests/fakes/command_output.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

TEST(PythonWeights, MatchTheGoldenWhenReadByPython) {
  const std::string file = absl::StrCat(::testing::TempDir(), "/craftfleet-python-weights.safetensors");
  const testing::GoldenAgent agent("lstm_cnn");
  const std::string scripts = SourcePath("tests/");
  const std::string command =
      absl::StrCat("python3 ", scripts, "agent/check_weights.py ", file, " ", scripts, "data/agents/lstm_cnn.json");
  ASSERT_TRUE(WriteFileSynced(file, SaveWeights(agent.spec, agent.weights)).ok());
  EXPECT_EQ(OutputOf(command), "18 tensors, 1525170 values agree\n");

  std::vector<float> other = agent.weights;
  other[agent.spec.params[1].offset + 2] = 0.5F;
  ASSERT_TRUE(WriteFileSynced(file, SaveWeights(agent.spec, other)).ok());
  EXPECT_THAT(OutputOf(command), ::testing::StartsWith("features_extractor.cnn.0.bias[2] is 0.5, want "));
  EXPECT_TRUE(RemoveAll(file).ok());
}

}  // namespace
}  // namespace craftfleet
