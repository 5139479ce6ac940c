#include "learner/runnable_config.h"

#include <functional>
#include <limits>
#include <string>
#include <utility>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <google/protobuf/descriptor.h>
#include <gtest/gtest.h>

#include "common/agent/nets/recurrent_core.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using testing::AllOf;
using testing::HasSubstr;

constexpr int64_t kGiB = int64_t{1} << 30;

absl::Status Check(const std::string& text, int64_t memory_bytes = 16 * kGiB) {
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::RunConfig config, ParseRunConfig(text, "config.txt"));
  CRAFTFLEET_ASSIGN_OR_RETURN(config, CompleteConfig(std::move(config)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  return CheckRunnable(config, spec, {memory_bytes, true});
}

TEST(RunnableConfig, EveryAgentRunsWithItsDefaults) {
  for (const char* agent :
       {"ppo_cnn", "lstm_cnn", "lstm_cnn_published", "oc_sa", "oc_ca", "ppo_resnet", "ppo_resnet_published",
        "achievement_distillation", "cnn_distillation", "grid_distillation"}) {
    EXPECT_THAT(Check(absl::StrCat("agent: \"", agent, "\"")), IsOk()) << agent;
  }
}

// The largest accepted fragment arrives unchanged.
TEST(RunnableConfig, AFragmentFitsAMessage) {
  wire::FragmentShape shape;
  shape.lanes = 1;
  shape.frame_bytes = 64 * 64 * 3;
  shape.state_size = 512;
  while (LargestFragmentBytes(shape) <= wire::kMaxMessageBytes) shape.states = ++shape.steps;
  shape.states = --shape.steps;
  Fragment fragment;
  fragment.frames.assign(static_cast<size_t>(shape.steps) * shape.frame_bytes, '\xFF');
  fragment.actions.assign(shape.steps, '\0');
  fragment.log_probs.assign(shape.steps, -1.F);
  fragment.values.assign(shape.steps, 1.F);
  fragment.rewards.assign(shape.steps, 1.F);
  fragment.ends.assign(shape.steps, StepEnd::kTruncated);
  fragment.truncation_values.assign(shape.steps, 1.F);
  Episode episode;
  episode.length = std::numeric_limits<int64_t>::max();
  episode.reward = 0.1;
  episode.achievements.fill(std::numeric_limits<int32_t>::max());
  for (episode.step = 0; episode.step < shape.steps; ++episode.step) fragment.episodes.push_back(episode);
  fragment.snapshot.game.assign(kMaxSnapshotBytes, 'x');
  fragment.snapshot.state.assign(shape.state_size, 1.F);
  fragment.states.assign(static_cast<size_t>(shape.states) * shape.state_size, 1.F);
  const size_t bytes = wire::ToProto(std::move(fragment)).ByteSizeLong();
  EXPECT_LE(bytes, static_cast<size_t>(LargestFragmentBytes(shape)));
  EXPECT_GT(bytes, static_cast<size_t>(LargestFragmentBytes(shape)) * 99 / 100) << "the bound is tight";
}

TEST(RunnableConfig, TheMessageLimitMatchesTheRun) {
  wire::FragmentShape shape;
  shape.frame_bytes = 64 * 64 * 3;
  shape.steps = 32;
  EXPECT_EQ(LargestMessageBytes(shape), 4 << 20);
  shape.steps = 1024;
  EXPECT_EQ(LargestMessageBytes(shape), LargestFragmentBytes(shape));
  shape.steps = 1 << 20;
  EXPECT_EQ(LargestMessageBytes(shape), wire::kMaxMessageBytes);

  Episode longest;
  longest.length = 1'000'000'000;
  longest.achievements.fill(std::numeric_limits<int32_t>::max());
  EXPECT_LT(wire::ToProto(std::vector<Episode>(10'000, longest)).ByteSizeLong(), 4 << 20);
}

TEST(RunnableConfig, AnOversizedRunIsRefusedWithTheLargestField) {
  const auto refuses = [](const std::string& text, const std::string& error) {
    EXPECT_THAT(Check(text), StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr(error), HasSubstr("want "))))
        << text;
  };
  refuses("fragment_steps: 8192 ppo { rollout_steps: 131072 }", "fragment_steps is 8192: a fragment may have");
  refuses("agent: \"ppo_resnet_published\" network { frame_size: 256 }",  // 510 fit, which do not divide a lane's steps
          "bytes, but a message at most 100663296: want at most 256");
  refuses("ppo { rollout_steps: 16777216 }", "ppo.rollout_steps is 16777216: the learner needs at least");
  refuses("ppo { rollout_steps: 1048576 minibatch_size: 1048576 }", "ppo.minibatch_size is 1048576: ");
  refuses("agent: \"ppo_spcnn\" network { frame_size: 256 }", "network.frame_size is 256: ");
  refuses("agent: \"ppo_spcnn\" gradient_shards: 256 ppo { minibatch_size: 256 }", "gradient_shards is 256: ");
  refuses("agent: \"achievement_distillation\" distillation { every_iterations: 1000 }",
          "distillation.every_iterations is 1000: ");
  refuses("agent: \"oc_sa\" network { patch: 1 stride: 1 }", "network.stride is 1: ");
  refuses("agent: \"lstm_cnn_published\" fragment_steps: 8192 lanes: 1 ppo { rollout_steps: 8192 }",
          "fragment_steps is 8192: ");
}

TEST(RunnableConfig, NumbersThatAreTooSmallAreRefused) {
  EXPECT_THAT(Check("agent: \"ppo_spcnn\" network { frame_size: 17 }"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("network.frame_size is 17, want ")));
  EXPECT_THAT(
      Check("ppo { adam_epsilon: 5e-324 }"),
      StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("ppo.adam_epsilon is "), HasSubstr("want "))));
}

TEST(RunnableConfig, TheMemoryLimitIsTheMachines) {
  EXPECT_GT(OwnMemoryBytes(), 100 << 20);
  const std::string text = "ppo { rollout_steps: 131072 }";  // 1.5 GiB of frames
  EXPECT_THAT(Check(text, 2 * kGiB), IsOk());
  EXPECT_THAT(Check(text, kGiB), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("it has 1.0 GiB")));
  EXPECT_THAT(Check(text, 0), IsOk()) << "the memory size is unknown";
}

// Each numeric field of a configuration, as "ppo.rollout_steps".
void VisitNumbers(const Descriptor* message, const std::string& prefix,
                  const std::function<void(const std::string& path)>& visit) {
  for (int i = 0; i < message->field_count(); ++i) {
    const FieldDescriptor* field = message->field(i);
    const std::string path = prefix + field->name();
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      VisitNumbers(field->message_type(), path + ".", visit);
    } else if (field->cpp_type() != FieldDescriptor::CPPTYPE_STRING &&
               field->cpp_type() != FieldDescriptor::CPPTYPE_BOOL &&
               field->cpp_type() != FieldDescriptor::CPPTYPE_ENUM) {
      visit(path);
    }
  }
}

// "ppo.epochs", "7" -> "ppo { epochs: 7 }"
std::string TextOf(const std::string& path, const std::string& value) {
  const size_t dot = path.find('.');
  if (dot == std::string::npos) return absl::StrCat(path, ": ", value);
  return absl::StrCat(path.substr(0, dot), " { ", path.substr(dot + 1), ": ", value, " }");
}

// Every extreme number is refused with its name and what was expected, or fits the machine.
TEST(RunnableConfig, EveryExtremeNumberIsRefusedByNameOrRuns) {
  int refused = 0;
  int taken = 0;
  VisitNumbers(v1::RunConfig::descriptor(), "", [&](const std::string& path) {
    for (const char* agent : {"oc_ca", "lstm_cnn_published"}) {
      for (const char* value :
           {"0",    "1",     "-1",      "2",        "255",        "256",           "257",
            "4096", "16384", "1048576", "16777216", "2147483647", "-2147483648",   "4611686018427387904",
            "nan",  "inf",   "-inf",    "1e300",    "5e-324",     "0.999999999999"}) {
        const std::string text = absl::StrCat("agent: \"", agent, "\" ", TextOf(path, value));
        const absl::Status status = Check(text);
        if (status.ok()) {
          ++taken;
          continue;
        }
        ++refused;
        EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << text;
        const std::string name = path.substr(path.find('.') + 1);
        EXPECT_THAT(std::string(status.message()), HasSubstr(name)) << text;
      }
    }
  });
  EXPECT_GT(refused, 300);
  EXPECT_GT(taken, 100);
}

// With 4,096 lanes, the maximum, and snapshots of the maximum size, messages about all lanes fit the limit, and the
// state of a checkpoint is smaller than protobuf's limit.
TEST(RunnableConfig, MessagesWithTheMaximumNumberOfLanesFit) {
  constexpr int kMostLanes = 4096;
  constexpr int64_t kLargestCount = int64_t{1} << 52;
  const auto fill = [](v1::Permit* permit) {
    permit->set_lane(kMostLanes - 1);
    permit->set_fragment(kLargestCount);
    permit->set_policy_version(kLargestCount);
  };
  v1::PermitRequest request;
  v1::PermitReply reply;
  for (int lane = 0; lane < kMostLanes; ++lane) {
    for (int i = 0; i < 2; ++i) {
      fill(request.add_active());
      fill(reply.add_lost());
    }
    fill(reply.add_granted());
    v1::LaneFailure* failure = request.add_failures();
    failure->set_lane(lane);
    failure->set_fragment(kLargestCount);
    failure->set_reason(std::string(wire::kMaxReasonBytes, 'r'));
  }
  request.set_actor(std::string(wire::kMaxTextBytes, 'a'));
  request.set_capacity(kMostLanes);
  EXPECT_THAT(wire::CheckPermitRequest(request, kMostLanes), IsOk());
  wire::FragmentShape smallest;
  smallest.steps = 1;
  EXPECT_LT(request.ByteSizeLong(), static_cast<size_t>(LargestMessageBytes(smallest)));
  EXPECT_LT(reply.ByteSizeLong(), static_cast<size_t>(wire::kMaxMessageBytes));

  v1::CheckpointState state;
  v1::LaneState* lane = state.add_lanes();
  lane->set_next_fragment(kLargestCount);
  lane->set_snapshot(std::string(kMaxSnapshotBytes, 's'));
  lane->set_previous_snapshot(std::string(kMaxSnapshotBytes, 's'));
  for (int i = 0; i < 4 * static_cast<int>(LstmLayer::kHidden); ++i) {
    lane->add_state(0.5F);
    lane->add_previous_state(0.5F);
  }
  EXPECT_LT(state.ByteSizeLong() * kMostLanes, static_cast<size_t>(std::numeric_limits<int32_t>::max()));
  // More lanes are refused.
  const std::string rest = " fragment_steps: 1 ppo { rollout_steps: ";
  EXPECT_THAT(Check(absl::StrCat("lanes: 4096", rest, "4096 }")), IsOk());
  EXPECT_THAT(Check(absl::StrCat("lanes: 4097", rest, "4097 }")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("lanes is 4097, want 1..4096")));
}

}  // namespace
}  // namespace craftfleet
