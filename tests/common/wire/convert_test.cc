#include "common/wire/convert.h"

#include <functional>
#include <limits>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// A change that makes a message invalid, and the expected error.
template <typename Message>
struct Wrong {
  std::string what;
  std::function<void(Message*)> damage;
  std::string error;
  friend void PrintTo(const Wrong& wrong, std::ostream* out) { *out << wrong.what; }
};

TEST(ConvertFragment, SurvivesARoundTrip) {
  v1::FragmentMessage message = wire::ToProto(SampleFragment(2, 7, 40, 3));
  v1::FragmentMessage received;
  ASSERT_TRUE(received.ParseFromString(message.SerializeAsString()));
  const auto fragment = wire::FromProto(&received, kSampleShape);
  ASSERT_THAT(fragment, IsOk());
  ExpectSameFragments(*fragment, SampleFragment(2, 7, 40, 3));
}

TEST(ConvertFragment, FramesAreRawWhenItIsRead) {
  Fragment fragment = SampleFragment(2, 7, 40);
  EXPECT_EQ(wire::ToProto(fragment).frame_format(), v1::FRAMES_RAW);
  fragment.frame_format = FrameFormat::kScene;
  v1::FragmentMessage message = wire::ToProto(fragment);
  EXPECT_EQ(message.frame_format(), v1::FRAMES_SCENE);
  EXPECT_THAT(wire::FromProto(&message, kSampleShape),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frame_format: 2, want raw")));
}

TEST(ConvertFragment, MovesItsBuffers) {
  Fragment fragment = SampleFragment(0, 0, 0);
  fragment.frames.reserve(1000);  // too long for the string to hold within itself
  const char* const frames = fragment.frames.data();
  v1::FragmentMessage message = wire::ToProto(std::move(fragment));
  EXPECT_EQ(message.frames().data(), frames);
  EXPECT_EQ(wire::FromProto(&message, kSampleShape)->frames.data(), frames);
}

TEST(ConvertFragment, MayHaveAStateBeforeEachStep) {
  wire::FragmentShape shape = kSampleShape;
  shape.states = shape.steps;
  v1::FragmentMessage message = wire::ToProto(SampleFragment(2, 7, 40, 3));
  EXPECT_THAT(wire::FromProto(&message, shape),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("states: 2 numbers, want 10")));
  Fragment fragment = SampleFragment(2, 7, 40, 3);
  fragment.states = {0, 1, -0.5F, 3, -1, 5, 0.25F, 7, 1, -9};
  message = wire::ToProto(fragment);
  ExpectSameFragments(*wire::FromProto(&message, shape), fragment);
}

TEST(ConvertSnapshot, SurvivesARoundTrip) {
  const LaneSnapshot sent = SampleFragment(1, 2, 3).snapshot;
  v1::SnapshotReply message = wire::ToProto(sent);
  EXPECT_EQ(*wire::FromProto(&message, 2), sent);
  message = wire::ToProto(sent);
  EXPECT_THAT(wire::FromProto(&message, 512),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("state: 2 numbers, want 512")));
  message.set_state(1, kNan);
  EXPECT_THAT(wire::FromProto(&message, 2),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("state: holds nan")));
}

class WrongFragment : public testing::TestWithParam<Wrong<v1::FragmentMessage>> {};

TEST_P(WrongFragment, IsRefusedByName) {
  v1::FragmentMessage message = wire::ToProto(SampleFragment(2, 7, 40));
  GetParam().damage(&message);
  EXPECT_THAT(wire::FromProto(&message, kSampleShape),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(GetParam().error)));
}

using FragmentMessage = v1::FragmentMessage;
const std::vector<Wrong<FragmentMessage>>& WrongFragments() {
  static const auto* const wrong = new std::vector<Wrong<FragmentMessage>>{
      {"LaneBelow", [](FragmentMessage* m) { m->set_lane(-1); }, "lane -1, want 0..2"},
      {"LaneAbove", [](FragmentMessage* m) { m->set_lane(3); }, "lane 3, want 0..2"},
      {"NoFrames", [](FragmentMessage* m) { m->clear_frames(); }, "frames: 0 bytes, want 60"},
      {"FramesLong", [](FragmentMessage* m) { m->mutable_frames()->push_back('x'); }, "frames: 61 bytes, want 60"},
      {"ActionsShort", [](FragmentMessage* m) { m->mutable_actions()->pop_back(); }, "actions: 4 bytes, want 5"},
      {"Action17", [](FragmentMessage* m) { (*m->mutable_actions())[2] = 17; }, "action 17 at 2, want 0..16"},
      {"Action255", [](FragmentMessage* m) { (*m->mutable_actions())[0] = '\xff'; }, "action 255 at 0, want 0..16"},
      {"LogProbsShort", [](FragmentMessage* m) { m->mutable_log_probs()->RemoveLast(); },
       "log_probs: 4 numbers, want 5"},
      {"ValuesLong", [](FragmentMessage* m) { m->add_values(1); }, "values: 6 numbers, want 5"},
      {"NoRewards", [](FragmentMessage* m) { m->clear_rewards(); }, "rewards: 0 numbers, want 5"},
      {"EndsShort", [](FragmentMessage* m) { m->mutable_ends()->pop_back(); }, "ends: 4 bytes, want 5"},
      {"EndOfNoKind", [](FragmentMessage* m) { (*m->mutable_ends())[4] = 3; }, "ends: 3 at 4, want 0..2"},
      {"NoTruncationValue", [](FragmentMessage* m) { m->clear_truncation_values(); },
       "truncation_values: 0 numbers, want 1"},
      {"EpisodeMissing", [](FragmentMessage* m) { m->mutable_episodes()->RemoveLast(); },
       "episodes: 1 episodes, want 2"},
      {"EpisodeTooMuch", [](FragmentMessage* m) { *m->add_episodes() = m->episodes(0); },
       "episodes: 3 episodes, want 2"},
      {"EpisodeStepOutside", [](FragmentMessage* m) { m->mutable_episodes(0)->set_step(5); }, "step 5"},
      {"EpisodeAtAnotherStep", [](FragmentMessage* m) { m->mutable_episodes(0)->set_step(2); }, "want step 1"},
      {"EpisodesOutOfOrder", [](FragmentMessage* m) { m->mutable_episodes()->SwapElements(0, 1); }, "want step 1"},
      {"AchievementsShort", [](FragmentMessage* m) { m->mutable_episodes(0)->mutable_achievements()->RemoveLast(); },
       "achievements: 21 counts, want 22"},
      {"StatesShort", [](FragmentMessage* m) { m->mutable_states()->RemoveLast(); }, "states: 1 numbers, want 2"},
      {"NoLastState", [](FragmentMessage* m) { m->clear_last_state(); }, "last_state: 0 numbers, want 2"},
      {"NoSnapshot", [](FragmentMessage* m) { m->clear_snapshot(); }, "snapshot is empty"},
  };
  return *wrong;
}

INSTANTIATE_TEST_SUITE_P(ConvertFragment, WrongFragment, testing::ValuesIn(WrongFragments()),
                         [](const auto& info) { return info.param.what; });

TEST(ConvertStepBatch, SurvivesARoundTrip) {
  StepBatch sent = SampleStepBatch();
  v1::PlayReply message;
  wire::ToProto(&sent, &message);
  v1::PlayReply received;
  ASSERT_TRUE(received.ParseFromString(message.SerializeAsString()));
  StepBatch batch;
  batch.snapshots = {"left", "from", "before", "!"};
  ASSERT_THAT(wire::FromProto(&received, 3, 12, 10000, &batch), IsOk());
  const StepBatch wanted = SampleStepBatch();
  EXPECT_EQ(batch.rewards, wanted.rewards);
  EXPECT_EQ(batch.ends, wanted.ends);
  EXPECT_EQ(batch.frames, wanted.frames);
  EXPECT_EQ(batch.last_frames, wanted.last_frames);
  ExpectSameEpisodes(batch.episodes, wanted.episodes);
  EXPECT_EQ(batch.snapshots, wanted.snapshots);
}

TEST(ConvertStepBatch, ReusedMessagesKeepNothingOfAnEarlierReply) {
  StepBatch first = SampleStepBatch();
  v1::PlayReply message;
  wire::ToProto(&first, &message);
  StepBatch second;
  second.frames = "one row only";
  second.rewards = {1};
  second.ends = {StepEnd::kNone};
  wire::ToProto(&second, &message);
  StepBatch batch = SampleStepBatch();
  ASSERT_THAT(wire::FromProto(&message, 1, 12, 10000, &batch), IsOk());
  EXPECT_EQ(batch.frames, "one row only");
  EXPECT_EQ(batch.last_frames, "");
  EXPECT_TRUE(batch.episodes.empty());
  EXPECT_TRUE(batch.snapshots.empty());
}

class WrongReply : public testing::TestWithParam<Wrong<v1::PlayReply>> {};

TEST_P(WrongReply, IsRefusedByName) {
  StepBatch sent = SampleStepBatch();
  v1::PlayReply message;
  wire::ToProto(&sent, &message);
  GetParam().damage(&message);
  StepBatch batch;
  EXPECT_THAT(wire::FromProto(&message, 3, 12, 10000, &batch),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(GetParam().error)));
}

using PlayReply = v1::PlayReply;
const std::vector<Wrong<PlayReply>>& WrongReplies() {
  static const auto* const wrong = new std::vector<Wrong<PlayReply>>{
      {"FramesShort", [](PlayReply* m) { m->mutable_frames()->pop_back(); }, "frames: 35 bytes, want 36"},
      {"RewardsLong", [](PlayReply* m) { m->add_rewards(0); }, "rewards: 4 numbers, want 3"},
      {"RewardNan", [](PlayReply* m) { m->set_rewards(2, kNan); }, "rewards: holds nan"},
      {"NoEnds", [](PlayReply* m) { m->clear_ends(); }, "ends: 0 bytes, want 3"},
      {"EndOfNoKind", [](PlayReply* m) { (*m->mutable_ends())[1] = '\x80'; }, "ends: 128 at 1, want 0..2"},
      {"NoLastFrame", [](PlayReply* m) { m->clear_last_frames(); }, "last_frames: 0 bytes, want 12"},
      {"EpisodeMissing", [](PlayReply* m) { m->mutable_episodes()->RemoveLast(); }, "episodes: 1 episodes, want 2"},
      {"EpisodeAtALaterStep", [](PlayReply* m) { m->mutable_episodes(0)->set_step(1); }, "want step 0"},
      {"EpisodeTooLong", [](PlayReply* m) { m->mutable_episodes(1)->set_length(10001); }, "episodes: length 10001"},
      {"NoAchievements", [](PlayReply* m) { m->mutable_episodes(1)->clear_achievements(); },
       "achievements: 0 counts, want 22"},
      {"SnapshotMissing", [](PlayReply* m) { m->mutable_snapshots()->RemoveLast(); }, "snapshots: 2 snapshots, want 3"},
  };
  return *wrong;
}

INSTANTIATE_TEST_SUITE_P(ConvertStepBatch, WrongReply, testing::ValuesIn(WrongReplies()),
                         [](const auto& info) { return info.param.what; });

TEST(ConvertMoments, SurviveARoundTrip) {
  const std::vector<Moment> sent = {SampleMoment(0), SampleMoment(9)};
  v1::PlayReply message;
  wire::ToProto(sent, &message);
  v1::PlayReply received;
  ASSERT_TRUE(received.ParseFromString(message.SerializeAsString()));
  const auto moments = wire::MomentsFromProto(&received, 2, 12, 27);
  ASSERT_THAT(moments, IsOk());
  ExpectSameMoments(*moments, sent);
  wire::ToProto(std::vector<Moment>{SampleMoment(3)}, &message);
  EXPECT_EQ(message.moments_size(), 1) << "an earlier reply's moments are cleared";
}

class WrongMoment : public testing::TestWithParam<Wrong<v1::Moment>> {};

TEST_P(WrongMoment, IsRefusedByName) {
  v1::PlayReply message;
  wire::ToProto(std::vector<Moment>{SampleMoment(1), SampleMoment(2)}, &message);
  GetParam().damage(message.mutable_moments(1));
  EXPECT_THAT(wire::MomentsFromProto(&message, 2, 12, 27),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(GetParam().error)));
}

const std::vector<Wrong<v1::Moment>>& WrongMoments() {
  static const auto* const wrong = new std::vector<Wrong<v1::Moment>>{
      {"NoFrame", [](v1::Moment* m) { m->clear_frame(); }, "moment.frame: 0 bytes, want 12"},
      {"PictureShort", [](v1::Moment* m) { m->mutable_picture()->pop_back(); }, "moment.picture: 26 bytes, want 27"},
      {"SemanticLong", [](v1::Moment* m) { m->mutable_semantic()->push_back(1); }, "semantic: 4097 bytes, want 4096"},
      {"CellOfNoKind", [](v1::Moment* m) { m->mutable_semantic()->back() = 19; }, "moment.semantic: a cell that is"},
      {"PlayerLeftOfTheWorld", [](v1::Moment* m) { m->set_player_x(-1); }, "moment.player: at -1, 2, want 0..63"},
      {"PlayerBelowTheWorld", [](v1::Moment* m) { m->set_player_y(64); }, "moment.player: at 61, 64, want 0..63"},
      {"ItemsMissing", [](v1::Moment* m) { m->mutable_inventory()->RemoveLast(); }, "inventory: 15 counts, want 16"},
      {"TenOfAnItem", [](v1::Moment* m) { m->set_inventory(4, 10); }, "moment.inventory: 10, want 0..9"},
      {"AchievementTooMuch", [](v1::Moment* m) { m->add_achievements(1); }, "achievements: 23 counts, want 22"},
      {"AchievementBelow0", [](v1::Moment* m) { m->set_achievements(0, -2); }, "achievements: -2, want at least 0"},
  };
  return *wrong;
}

INSTANTIATE_TEST_SUITE_P(ConvertMoments, WrongMoment, testing::ValuesIn(WrongMoments()),
                         [](const auto& info) { return info.param.what; });

TEST(ConvertActions, OnePerLane) {
  v1::StepLanes request;
  request.add_lanes(4);
  request.add_lanes(2);
  request.set_actions(std::string({16, 0}));
  std::vector<Action> actions = {Action::kSleep};
  ASSERT_THAT(wire::ActionsFromProto(request, &actions), IsOk());
  EXPECT_THAT(actions, ElementsAre(Action::kMakeIronSword, Action::kNoop));

  request.set_actions(std::string({16, 0, 0}));
  EXPECT_THAT(wire::ActionsFromProto(request, &actions),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("actions: 3 bytes, want 2")));
  request.set_actions(std::string({0, 17}));
  EXPECT_THAT(wire::ActionsFromProto(request, &actions),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("action 17 at 1, want 0..16")));
}

}  // namespace
}  // namespace craftfleet
