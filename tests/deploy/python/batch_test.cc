// The engine of the Python package without Python: many games on several threads.

#include "engine/batch.h"

#include <sys/wait.h>
#include <unistd.h>

#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "engine/setup.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

#if defined(__SANITIZE_THREAD__)
constexpr bool kThreadSanitizer = true;
#elif defined(__has_feature)
constexpr bool kThreadSanitizer = __has_feature(thread_sanitizer);
#else
constexpr bool kThreadSanitizer = false;
#endif

std::shared_ptr<Setup> SmallSetup(int length) {
  auto setup = Setup::Create({"crafter", {32, 32}, {9, 9}, {64, 64}, length, ""});
  EXPECT_THAT(setup, IsOk());
  return *setup;
}

Batch::Options OptionsOf(int lanes, int threads) {
  Batch::Options options;
  options.lanes = lanes;
  options.threads = threads;
  options.semantic = true;
  return options;
}

void ResetAll(Batch* batch) {
  std::vector<int> lanes;
  std::vector<int64_t> seeds;
  for (int lane = 0; lane < batch->options().lanes; ++lane) {
    lanes.push_back(lane);
    seeds.push_back(100 + lane);
  }
  EXPECT_THAT(batch->Reset(lanes, std::vector<bool>(lanes.size(), true), seeds), IsOk());
}

// Everything that `steps` steps show.
std::vector<uint8_t> Play(Batch* batch, int steps) {
  std::vector<uint8_t> seen;
  std::vector<int64_t> actions(batch->options().lanes);
  for (int step = 0; step < steps; ++step) {
    for (size_t lane = 0; lane < actions.size(); ++lane) actions[lane] = (5 * step + 3 * lane) % kNumActions;
    EXPECT_THAT(batch->Step(actions), IsOk());
    Batch::Rows& rows = batch->rows();
    seen.insert(seen.end(), rows.frames.begin(), rows.frames.end());
    seen.insert(seen.end(), rows.semantic.begin(), rows.semantic.end());
    for (const double reward : rows.rewards) seen.push_back(static_cast<uint8_t>(10 * reward + 50));
  }
  return seen;
}

TEST(Batch, GamesDoNotDependOnThreads) {
  Batch one(SmallSetup(9), OptionsOf(7, 1));
  ResetAll(&one);
  const std::vector<uint8_t> expected = Play(&one, 40);
  for (const int threads : {2, 5}) {
    Batch many(SmallSetup(9), OptionsOf(7, threads));
    ResetAll(&many);
    EXPECT_EQ(Play(&many, 40), expected);
  }
}

TEST(Batch, CallsFromSeveralThreadsAreRefusedOrDoneWhole) {
  Batch batch(SmallSetup(0), OptionsOf(4, 2));
  ResetAll(&batch);
  const auto step = [&batch] {
    const std::vector<int64_t> actions(4, 0);
    for (int i = 0; i < 50; ++i) {
      const absl::Status status = batch.Step(actions);
      EXPECT_TRUE(status.ok() || absl::StrContains(status.message(), "another thread")) << status;
    }
  };
  std::thread other(step);
  step();
  other.join();
  EXPECT_THAT(batch.Save(0), IsOk());
}

TEST(Batch, AForkPlaysOnWithThreadsOfItsOwn) {
  if (kThreadSanitizer) GTEST_SKIP() << "ThreadSanitizer does not support threads after a fork";
  Batch batch(SmallSetup(0), OptionsOf(4, 3));
  Batch alone(SmallSetup(0), OptionsOf(4, 1));
  for (Batch* each : {&batch, &alone}) {
    ResetAll(each);
    Play(each, 2);
  }
  const std::vector<uint8_t> expected = Play(&alone, 2);
  const pid_t child = fork();
  if (child == 0) _exit(Play(&batch, 2) == expected ? 0 : 1);
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  EXPECT_EQ(Play(&batch, 2), expected);
}

TEST(Lane, ARestoredGameIsDrawnAndContinuesAlike) {
  const auto setup = SmallSetup(0);
  Lane game(setup, 3);
  std::vector<uint8_t> frame(setup->renderer().frame_bytes());
  game.Reset(absl::MakeSpan(frame));
  for (int step = 0; step < 250; ++step) game.Step(Action::kNoop, absl::MakeSpan(frame));  // into the night
  std::vector<uint8_t> other_frame(frame.size());
  game.DrawFromStream(setup->renderer(), absl::MakeSpan(other_frame));
  Lane other(setup, 4);
  ASSERT_THAT(other.Restore(game.Save()), IsOk());
  other.Redraw(setup->renderer(), absl::MakeSpan(other_frame));
  EXPECT_EQ(other_frame, frame);
  game.Step(Action::kDo, absl::MakeSpan(frame));
  other.Step(Action::kDo, absl::MakeSpan(other_frame));
  EXPECT_EQ(other_frame, frame);
  EXPECT_EQ(other.Save(), game.Save());
}

TEST(Setup, KeepsPicturesOfOtherSizesAndNamesBadOnes) {
  const auto setup = SmallSetup(0);
  EXPECT_EQ(*setup->RendererOf({90, 90}), *setup->RendererOf({90, 90}));
  for (int size = 18; size < 40; ++size) EXPECT_THAT(setup->RendererOf({size, size}), IsOk());
  EXPECT_THAT(setup->RendererOf({17, 64}), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("picture width 17")));
}

}  // namespace
}  // namespace craftfleet
