#include "deploy/cli/eval/eval_progress.h"

#include <sstream>

#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

TEST(EvalProgress, IsALineEveryTenSeconds) {
  FakeClock clock;
  std::ostringstream out;
  EvalProgress progress({"sampled", 100, /*terminal=*/false}, &out, &clock);
  progress.Update(3);
  clock.Advance(absl::Seconds(9));
  progress.Update(5);
  EXPECT_EQ(out.str(), "") << "a short evaluation needs none";
  clock.Advance(absl::Seconds(1));
  progress.Update(20);
  progress.Update(21);
  EXPECT_EQ(out.str(), "sampled: 20 of 100 episodes, 40s left\n");
  clock.Advance(absl::Seconds(10));
  progress.Update(50);
  progress.Finish();
  EXPECT_EQ(out.str(), "sampled: 20 of 100 episodes, 40s left\nsampled: 50 of 100 episodes, 20s left\n");
}

TEST(EvalProgress, IsDrawnInPlaceOnATerminal) {
  FakeClock clock;
  std::ostringstream out;
  EvalProgress progress({"argmax", 4, /*terminal=*/true}, &out, &clock);
  clock.Advance(absl::Milliseconds(200));
  progress.Update(0);
  EXPECT_EQ(out.str(), "\r\033[Kargmax: 0 of 4 episodes");
  out.str("");
  clock.Advance(absl::Seconds(1));
  progress.Update(4);
  EXPECT_EQ(out.str(), "\r\033[Kargmax: 4 of 4 episodes, 0s left");
  out.str("");
  progress.Finish();
  EXPECT_EQ(out.str(), "\r\033[K") << "what follows begins on a clean line";
}

}  // namespace
}  // namespace craftfleet
