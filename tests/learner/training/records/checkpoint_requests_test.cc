#include "learner/training/records/checkpoint_requests.h"

#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

TEST(CheckpointRequests, ARequestWaitsForTheAnswer) {
  CheckpointRequests requests;
  EXPECT_FALSE(requests.pending());
  std::thread trainer([&requests] {
    ASSERT_TRUE(WaitUntil([&requests] { return requests.pending(); }));
    requests.Answer(7);
  });
  const absl::StatusOr<int64_t> iteration = requests.Ask(absl::Seconds(30));
  trainer.join();
  ASSERT_THAT(iteration, IsOk());
  EXPECT_EQ(*iteration, 7);
  EXPECT_FALSE(requests.pending());
}

TEST(CheckpointRequests, ReturnsTheWriteError) {
  CheckpointRequests requests;
  std::thread trainer([&requests] {
    ASSERT_TRUE(WaitUntil([&requests] { return requests.pending(); }));
    requests.Answer(absl::ResourceExhaustedError("disk full"));
  });
  EXPECT_THAT(requests.Ask(absl::Seconds(30)), StatusIs(absl::StatusCode::kResourceExhausted, "disk full"));
  trainer.join();
}

TEST(CheckpointRequests, ATimedOutRequestIsStillServed) {
  CheckpointRequests requests;
  EXPECT_THAT(requests.Ask(absl::Milliseconds(1)),
              StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("it will be written after the current update")));
  EXPECT_TRUE(requests.pending());
}

TEST(CheckpointRequests, CloseWakesWaitingRequests) {
  CheckpointRequests requests;
  std::thread trainer([&requests] {
    ASSERT_TRUE(WaitUntil([&requests] { return requests.pending(); }));
    requests.Close();
  });
  EXPECT_THAT(requests.Ask(absl::Seconds(30)), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("stopping")));
  trainer.join();
}

}  // namespace
}  // namespace craftfleet
