// Sessions whose games together need more than one message.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/env_client.h"
#include "common/config/env_name.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/protocol.h"
#include "envserver/env_service.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace large_replies_test {

using testing::IsEmpty;
using testing::SizeIs;

constexpr int kLength = 2;     // of an episode
constexpr int kPixels = 1024;  // the largest frames
constexpr size_t kFrameBytes = size_t{kPixels} * kPixels * 3;
constexpr int kGames = 40;
static_assert(kGames * kFrameBytes > wire::kMaxMessageBytes);
static_assert(2 * EnvClient::kOpenAtOnce * kMaxSnapshotBytes <= EnvServiceImpl::kMaxRequestBytes);

v1::SessionHello LargeHello() {
  v1::SessionHello hello = SampleHello(kLength);
  hello.mutable_env()->set_frame_size(kPixels);
  return hello;
}

std::vector<EnvClient::Lane> NewGames(int count) {
  std::vector<EnvClient::Lane> lanes;
  for (int lane = 0; lane < count; ++lane) lanes.push_back({lane, lane + 7, 1, ""});
  return lanes;
}

std::vector<int> Numbers(const std::vector<EnvClient::Lane>& lanes) {
  std::vector<int> numbers;
  for (const EnvClient::Lane& lane : lanes) numbers.push_back(lane.lane);
  return numbers;
}

absl::Status Step(EnvClient* client, const std::vector<int>& lanes, bool snapshot, StepBatch* batch) {
  std::vector<Action> actions;
  for (const int lane : lanes) actions.push_back(static_cast<Action>(lane % kNumActions));
  absl::Status sent = client->SendStep(lanes, actions, snapshot);
  return sent.ok() ? client->ReceiveStep(batch) : sent;
}

// The same games in two sessions: all at once, and one at a time.
TEST(LargeReplies, GamesAreTheSameAsInSmallReplies) {
  const EnvServer env;
  EnvClient all(env.Connect(), LargeHello(), kFrameBytes);
  EnvClient single(env.Connect(), LargeHello(), kFrameBytes);
  ASSERT_THAT(all.Connect(absl::Seconds(10)), IsOk());
  ASSERT_THAT(single.Connect(absl::Seconds(10)), IsOk());
  const std::vector<EnvClient::Lane> games = NewGames(kGames);
  std::string frames;
  ASSERT_THAT(all.Open(games, &frames), IsOk());
  ASSERT_EQ(frames.size(), kGames * kFrameBytes);
  std::string frame;
  for (const EnvClient::Lane& game : games) {
    ASSERT_THAT(single.Open({game}, &frame), IsOk());
    EXPECT_TRUE(frame == frames.substr(game.lane * kFrameBytes, kFrameBytes)) << game.lane;
  }
  for (int step = 0; step < kLength; ++step) {
    const bool last = step + 1 == kLength;
    StepBatch batch;
    ASSERT_THAT(Step(&all, Numbers(games), last, &batch), IsOk());
    ASSERT_EQ(batch.frames.size(), kGames * kFrameBytes);
    EXPECT_EQ(batch.last_frames.size(), last ? kGames * kFrameBytes : 0);
    EXPECT_THAT(batch.rewards, SizeIs(kGames));
    EXPECT_THAT(batch.episodes, SizeIs(last ? kGames : 0));
    ASSERT_THAT(batch.ends, SizeIs(kGames));
    ASSERT_THAT(batch.snapshots, SizeIs(last ? kGames : 0));
    for (const int lane : Numbers(games)) {
      StepBatch one;
      ASSERT_THAT(Step(&single, {lane}, last, &one), IsOk());
      EXPECT_TRUE(one.frames == batch.frames.substr(lane * kFrameBytes, kFrameBytes)) << lane;
      EXPECT_EQ(one.rewards[0], batch.rewards[lane]);
      EXPECT_EQ(one.ends[0], batch.ends[lane]);
      if (!last) continue;
      EXPECT_TRUE(one.last_frames == batch.last_frames.substr(lane * kFrameBytes, kFrameBytes)) << lane;
      EXPECT_TRUE(one.snapshots[0] == batch.snapshots[lane]) << lane;
      EXPECT_EQ(one.episodes[0].length, batch.episodes[lane].length);
    }
  }
}

// 1,600 lanes with the largest snapshots. None holds a game, so that each is refused by itself.
TEST(LargeReplies, ManyLargeSnapshotsAreOpenedInSeveralRequests) {
  constexpr int kMany = 1600;
  static_assert(kMany * kMaxSnapshotBytes > wire::kMaxMessageBytes);
  const EnvServer env;
  EnvClient client(env.Connect(), SampleHello(50), 64 * 64 * 3);
  ASSERT_THAT(client.Connect(absl::Seconds(10)), IsOk());
  const size_t envelope = SealSnapshot(0, "").size();
  const std::string snapshot = SealSnapshot(EnvDigest("crafter", 50), std::string(kMaxSnapshotBytes - envelope, 'x'));
  ASSERT_EQ(snapshot.size(), kMaxSnapshotBytes);
  std::vector<EnvClient::Lane> lanes = NewGames(kMany);
  for (EnvClient::Lane& lane : lanes) lane.snapshot = snapshot;
  std::string frames;
  std::vector<EnvClient::Refused> refused;
  ASSERT_THAT(client.Open(lanes, &frames, &refused), IsOk());
  ASSERT_THAT(refused, SizeIs(kMany));
  for (int lane = 0; lane < kMany; ++lane) EXPECT_EQ(refused[lane].lane, lane);
  EXPECT_THAT(frames, IsEmpty());
  EXPECT_TRUE(client.connected());
}

}  // namespace large_replies_test
}  // namespace craftfleet
