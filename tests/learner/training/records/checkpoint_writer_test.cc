#include "learner/training/records/checkpoint_writer.h"

#include <sys/stat.h>

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/dropping_disk.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/plain_user.h"
#include "tests/fakes/wait_until.h"
#include "tests/learner/run/run_samples.h"
#include "tests/learner/training/records/open_run.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr rlim_t kFull = 2500;  // bytes; less than the weights of SampleCheckpoint

class CheckpointWriterTest : public OpenRun {
 protected:
  CheckpointWriter Every(int iterations) {
    return CheckpointWriter(iterations, {run_.get(), &requests_, &disk_, &clock_, [this] { return Make(); }});
  }
  Checkpoint Make() {
    ++made_;
    return SampleCheckpoint(iteration_);
  }
  // Calls the writer as training does after each iteration.
  void FinishIteration(CheckpointWriter* writer) {
    ++iteration_;
    ASSERT_THAT(writer->OnIteration(iteration_), IsOk());
  }
  std::vector<std::string> Written() const { return run_->checkpoints().ListNewestFirst().value(); }
  // Requests a checkpoint like the admin service, in another thread, and serves it.
  absl::StatusOr<int64_t> Request(CheckpointWriter* writer) {
    absl::StatusOr<int64_t> answer;
    std::thread client([&] { answer = requests_.Ask(absl::Minutes(4)); });
    EXPECT_TRUE(WaitUntil([this] { return requests_.pending(); }));
    writer->ServeRequests(iteration_);
    client.join();
    return answer;
  }

  int64_t iteration_ = 0;     // number of finished iterations
  std::atomic<int> made_{0};  // number of checkpoints made
  StopFlag stop_;
  DiskWait disk_{&stop_, &clock_, absl::ZeroDuration()};
  CheckpointRequests requests_;
};

TEST_F(CheckpointWriterTest, WritesEveryNthIteration) {
  CheckpointWriter writer = Every(3);
  for (int i = 0; i < 7; ++i) FinishIteration(&writer);
  EXPECT_THAT(Written(), ElementsAre("iter-00000006", "iter-00000003"));
  EXPECT_EQ(made_, 2);
}

// Periods are counted over the whole run, including earlier starts.
TEST_F(CheckpointWriterTest, AResumedRunWritesAtTheSameIterations) {
  iteration_ = 4;
  CheckpointWriter writer = Every(3);
  for (int i = 0; i < 3; ++i) FinishIteration(&writer);
  EXPECT_THAT(Written(), ElementsAre("iter-00000006"));
}

TEST_F(CheckpointWriterTest, AFailedCheckpointIsRetriedAfterTheNextIteration) {
  CheckpointWriter writer = Every(3);
  iteration_ = 2;
  testing::internal::CaptureStderr();
  {
    const FileSizeLimit limit(kFull);
    FinishIteration(&writer);
    FinishIteration(&writer);
  }
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("error: checkpoint of iteration 3: "), HasSubstr("error: checkpoint of iteration 4: "),
                    HasSubstr("File too large; training continues and tries again")));
  EXPECT_THAT(Written(), IsEmpty());
  FinishIteration(&writer);
  EXPECT_THAT(Written(), ElementsAre("iter-00000005"));
  FinishIteration(&writer);
  FinishIteration(&writer);
  EXPECT_THAT(Written(), ElementsAre("iter-00000006", "iter-00000005")) << "then at the usual iterations";
}

TEST_F(CheckpointWriterTest, EndsTrainingAfterATakeover) {
  CheckpointWriter writer = Every(1);
  TakeOver();
  EXPECT_THAT(writer.OnIteration(1), StatusIs(absl::StatusCode::kAborted, HasSubstr("taken over")));
}

TEST_F(CheckpointWriterTest, AnswersARequestWithTheLastFinishedIteration) {
  CheckpointWriter writer = Every(100);
  iteration_ = 7;
  EXPECT_EQ(Request(&writer).value(), 7);
  EXPECT_THAT(Written(), ElementsAre("iter-00000007"));
  EXPECT_EQ(Request(&writer).value(), 7);
  EXPECT_EQ(made_, 1) << "that iteration already has one";
  ++iteration_;
  EXPECT_EQ(Request(&writer).value(), 8);
}

TEST_F(CheckpointWriterTest, WithoutARequestNothingIsWritten) {
  CheckpointWriter writer = Every(100);
  writer.ServeRequests(7);
  EXPECT_EQ(made_, 0);
}

TEST_F(CheckpointWriterTest, AFailedRequestGetsTheError) {
  CheckpointWriter writer = Every(100);
  const FileSizeLimit limit(kFull);
  EXPECT_THAT(Request(&writer), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("File too large")));
}

TEST_F(CheckpointWriterTest, TheLastCheckpointIsWrittenOnce) {
  CheckpointWriter writer = Every(2);
  FinishIteration(&writer);
  FinishIteration(&writer);
  EXPECT_THAT(writer.WriteLast(2), IsOk());
  EXPECT_EQ(made_, 1);
  ++iteration_;
  EXPECT_THAT(writer.WriteLast(3), IsOk());
  EXPECT_THAT(Written(), ElementsAre("iter-00000003", "iter-00000002"));
}

TEST_F(CheckpointWriterTest, AfterAChangeTheLastCheckpointIsWrittenAgain) {
  CheckpointWriter writer = Every(100);
  iteration_ = 7;
  EXPECT_EQ(Request(&writer).value(), 7);
  writer.NoteChange();
  EXPECT_THAT(writer.WriteLast(7), IsOk());
  EXPECT_EQ(made_, 2);
}

TEST_F(CheckpointWriterTest, TheLastCheckpointWaitsForSpace) {
  CheckpointWriter writer = Every(100);
  iteration_ = 5;
  auto limit = std::make_unique<FileSizeLimit>(kFull);
  absl::Status status = absl::UnknownError("still waiting");
  std::thread training([&] { status = writer.WriteLast(5); });
  ASSERT_TRUE(WaitUntil([this] { return made_ >= 2; })) << "it retries";
  limit.reset();
  training.join();
  EXPECT_THAT(status, IsOk());
  EXPECT_THAT(Written(), ElementsAre("iter-00000005"));
}

TEST_F(CheckpointWriterTest, AStopEndsTheWaitForSpace) {
  CheckpointWriter writer = Every(100);
  const FileSizeLimit limit(kFull);
  stop_.Set();
  testing::internal::CaptureStderr();
  EXPECT_THAT(writer.WriteLast(0), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("File too large")));
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("the last checkpoint will be written once there is space"));
  EXPECT_EQ(made_, 1);
}

TEST_F(CheckpointWriterTest, TheLastCheckpointWaitsUntilItMayBeWritten) {
  CheckpointWriter writer = Every(100);
  ASSERT_EQ(::chmod(temp_.path().c_str(), 0755), 0);
  ASSERT_EQ(::chmod((logdir_ + "/checkpoints").c_str(), 0555), 0);
  const PlainUser user;
  stop_.Set();
  testing::internal::CaptureStderr();
  EXPECT_THAT(writer.WriteLast(0), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("Permission denied")));
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("the last checkpoint will be written once that is allowed; make that disk writable"));
}

// A full disk may get free space; a failed sync ends the run.
TEST_F(CheckpointWriterTest, OtherErrorsOfTheLastCheckpointAreNotRetried) {
  CheckpointWriter writer = Every(100);
  DroppingDisk::Get().FailSync("weights.safetensors", 1);
  EXPECT_THAT(writer.WriteLast(0), testing::Not(IsOk()));
  EXPECT_EQ(made_, 1);
}

TEST_F(CheckpointWriterTest, ReportsTheAgeOfTheLastCheckpoint) {
  CheckpointWriter writer = Every(2);
  clock_.Advance(absl::Seconds(10));
  EXPECT_EQ(writer.age(), absl::Seconds(10)) << "since the start";
  FinishIteration(&writer);
  EXPECT_EQ(writer.age(), absl::Seconds(10));
  FinishIteration(&writer);
  EXPECT_EQ(writer.age(), absl::ZeroDuration());
  clock_.Advance(absl::Seconds(3));
  {
    const FileSizeLimit limit(kFull);
    ++iteration_;
    EXPECT_THAT(writer.Write(), testing::Not(IsOk()));
  }
  EXPECT_EQ(writer.age(), absl::Seconds(3)) << "failed checkpoints don't count";
}

}  // namespace
}  // namespace craftfleet
