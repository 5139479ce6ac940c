#include "common/agent/agent_spec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(AgentSpec, PpoCnnHasThePapersSize) {
  const absl::StatusOr<AgentSpec> spec = FindAgent("ppo_cnn");
  ASSERT_TRUE(spec.ok()) << spec.status();
  EXPECT_EQ(spec->name, "ppo_cnn");
  EXPECT_EQ(spec->frame_size, 64);
  EXPECT_EQ(spec->frame_bytes(), 12288);
  EXPECT_EQ(spec->param_count, 609970);
}

TEST(AgentSpec, ParametersAreContiguous) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  int64_t offset = 0;
  for (const ParamSpec& param : spec.params) {
    EXPECT_EQ(param.offset, offset) << param.name;
    int64_t size = 1;
    for (const int64_t length : param.shape) size *= length;
    EXPECT_EQ(param.size, size) << param.name;
    offset += size;
  }
  EXPECT_EQ(offset, spec.param_count);
}

TEST(AgentSpec, UnknownNamesErrorListsTheKnownOnes) {
  const absl::Status status = FindAgent("ppo_rnn").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()),
              ::testing::AllOf(::testing::HasSubstr("ppo_rnn"), ::testing::HasSubstr("ppo_cnn")));
}

}  // namespace
}  // namespace craftfleet
