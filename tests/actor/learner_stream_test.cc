#include "actor/learner_stream.h"

#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/server.h"
#include "tests/fakes/fake_learner_service.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;

using Answer = FakeLearnerService::Answer;

// A stream to a fake learner. As in an actor, a thread asks for permits all the time.
class LearnerStreamTest : public testing::Test {
 protected:
  LearnerStreamTest() : client_(wire::Connect(address())) { StartLearner(); }
  ~LearnerStreamTest() override {
    service_.ResumeReading();
    stream_.Stop();
    if (asking_.joinable()) asking_.join();
  }

  std::string address() const { return "unix:" + (folder_ / "learner"); }
  void StartLearner() { learner_ = *wire::Server::Create({address()}, {&service_}); }
  void StopLearner() { learner_.reset(); }

  void Start() {
    stream_.Start();
    asking_ = std::thread([this] {
      for (absl::Status status; !absl::IsCancelled(status);) {
        status = stream_.Ask({}).status();
        absl::SleepFor(absl::Milliseconds(status.ok() ? 10 : 200));
      }
    });
  }

  HeldPermit PermitOf(int lane, int64_t number) { return {{lane, number, 5}, 1}; }
  // Pushes a fragment for which there is a permit.
  void Push(int lane, int64_t number) {
    permits_.Add(PermitOf(lane, number));
    EXPECT_THAT(stream_.Push(SampleFragment(lane, number, 5)), IsOk());
  }
  // The same with more bytes than any window has room for, so that they can't be written until they are read.
  void PushLarge(int lane) {
    permits_.Add(PermitOf(lane, 0));
    Fragment fragment = SampleFragment(lane, 0, 5);
    fragment.frames.assign(8 << 20, 'f');
    EXPECT_THAT(stream_.Push(std::move(fragment)), IsOk());
  }
  // Starts the stream, has a request and fragment 0 of lane 0 answered, and leaves the writer within the large fragment
  // of lane 1, since the learner reads no more.
  void BlockTheWriter() {
    service_.PauseReadingAfter(2);
    stream_.Start();
    EXPECT_THAT(stream_.Ask({}), IsOk());
    Push(0, 0);
    ASSERT_TRUE(WaitUntil([this] { return service_.received().size() == 1; }));
    PushLarge(1);
    absl::SleepFor(absl::Milliseconds(200));
  }
  bool WaitForVerdicts() {
    return WaitUntil([this] { return permits_.Active().empty(); });
  }
  std::vector<int> LanesReceived() const {
    std::vector<int> lanes;
    for (const v1::FragmentMessage& message : service_.received()) lanes.push_back(message.lane());
    return lanes;
  }

  const TempFolder folder_;
  FakeLearnerService service_;
  std::unique_ptr<wire::Server> learner_;
  const LearnerClient client_;
  PermitTracker permits_{1};
  LearnerStream stream_{&client_, "an actor", &permits_};
  std::thread asking_;
};

TEST_F(LearnerStreamTest, SendsFragmentsInOrderAndReleasesTheirPermits) {
  Start();
  for (int lane = 0; lane < 5; ++lane) Push(lane, 0);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1, 2, 3, 4));
  EXPECT_EQ(stream_.accepted(), 5);
  EXPECT_EQ(stream_.resent(), 0);
  v1::FragmentMessage third = service_.received()[2];
  EXPECT_EQ(third.actor(), "an actor");
  ExpectSameFragments(*wire::FromProto(&third, kSampleShape), SampleFragment(2, 0, 5));
}

TEST_F(LearnerStreamTest, ResendsFragmentsWithoutAVerdictAfterTheStreamBreaks) {
  service_.Script({Answer::kAccept, Answer::kBreak, Answer::kBreak});
  Start();
  for (int lane = 0; lane < 3; ++lane) Push(lane, 0);
  ASSERT_TRUE(WaitUntil([this] { return stream_.resent() >= 1; }));
  EXPECT_EQ(permits_.Active().front().lane, 1) << "its permit is held until the verdict";
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1, 1, 1, 2));
  EXPECT_EQ(service_.received()[3].SerializeAsString(), service_.received()[1].SerializeAsString());
  EXPECT_EQ(stream_.accepted(), 3);
  EXPECT_GE(stream_.resent(), 2) << "the last one may also have been sent";
}

TEST_F(LearnerStreamTest, SendsABoundedNumberBeforeTheFirstVerdict) {
  service_.Script(std::vector<Answer>(20, Answer::kSilence));
  Start();
  for (int lane = 0; lane < 20; ++lane) Push(lane, 0);
  EXPECT_TRUE(WaitUntil([this] { return service_.received().size() == 16; }));
  EXPECT_FALSE(WaitUntil([this] { return service_.received().size() > 16; }, absl::Milliseconds(200)));
  EXPECT_EQ(permits_.Active().size(), 20);
}

TEST_F(LearnerStreamTest, WaitsForAnUnreachableLearner) {
  StopLearner();
  Start();
  Push(0, 0);
  Push(1, 0);
  EXPECT_FALSE(WaitUntil([this] { return permits_.Active().size() < 2; }, absl::Milliseconds(300)));
  StartLearner();
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1));
}

TEST_F(LearnerStreamTest, ContinuesAfterTheLearnerReturns) {
  Start();
  Push(0, 0);
  ASSERT_TRUE(WaitForVerdicts());
  StopLearner();
  StartLearner();
  Push(0, 1);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_EQ(stream_.accepted(), 2);
}

TEST_F(LearnerStreamTest, DropWaitingDropsUnsentFragments) {
  service_.Script(std::vector<Answer>(16, Answer::kSilence));
  Start();
  for (int lane = 0; lane < 20; ++lane) Push(lane, 0);
  ASSERT_TRUE(WaitUntil([this] { return service_.received().size() == 16; }));
  stream_.DropWaiting();
  EXPECT_EQ(permits_.Active().size(), 16) << "those under way get a verdict";
}

TEST_F(LearnerStreamTest, EveryVerdictReleasesThePermit) {
  service_.Script({Answer::kDuplicate, Answer::kExpire, Answer::kRefuse});
  Start();
  for (int lane = 0; lane < 4; ++lane) Push(lane, 0);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_EQ(stream_.accepted(), 2) << "one was accepted the first time";
  EXPECT_EQ(stream_.refused(), 2);
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1, 2, 3));
}

// The fragment is sent again on the next stream.
TEST_F(LearnerStreamTest, AnImpossibleAnswerEndsTheStream) {
  int64_t resent = 0;
  for (const Answer answer : {Answer::kWrongVerdict, Answer::kBadVerdict, Answer::kUnasked}) {
    service_.Script({answer});
    if (resent == 0) Start();
    Push(0, resent);
    ASSERT_TRUE(WaitForVerdicts());
    EXPECT_EQ(stream_.resent(), ++resent);
    EXPECT_EQ(stream_.accepted(), resent);
  }
  EXPECT_EQ(stream_.refused(), 0);
}

TEST_F(LearnerStreamTest, AskReturnsWhyTheStreamEnded) {
  service_.Script({Answer::kBreak});
  stream_.Start();
  EXPECT_THAT(stream_.Ask({}), IsOk());
  service_.IgnoreRequests();
  Push(0, 0);
  EXPECT_THAT(stream_.Ask({}), StatusIs(absl::StatusCode::kUnavailable, testing::HasSubstr("broken off")));
}

TEST_F(LearnerStreamTest, ARequestThatIsNotAnsweredIsAnErrorWithin5Seconds) {
  service_.IgnoreRequests();
  stream_.Start();
  const absl::Time start = absl::Now();
  EXPECT_THAT(stream_.Ask({}),
              StatusIs(absl::StatusCode::kDeadlineExceeded, testing::HasSubstr("no answer within 4s")));
  EXPECT_LT(absl::Now() - start, absl::Seconds(5));
}

// On a slow link, a lease must not lapse while megabytes are sent.
TEST_F(LearnerStreamTest, ARequestOvertakesTheFragmentsThatWait) {
  constexpr int kFragments = 8;
  ASSERT_NO_FATAL_FAILURE(BlockTheWriter());
  for (int lane = 2; lane < kFragments; ++lane) PushLarge(lane);
  asking_ = std::thread([this] { EXPECT_THAT(stream_.Ask({}), IsOk()); });
  absl::SleepFor(absl::Milliseconds(200));
  service_.ResumeReading();
  ASSERT_TRUE(WaitForVerdicts());
  asking_.join();
  EXPECT_EQ(service_.order(), "pff" + std::string("p") + std::string(kFragments - 2, 'f'));
}

// Its caller has learned that the stream ended, and asks anew: two requests at once would end the next stream for good.
TEST_F(LearnerStreamTest, ARequestThatWaitedWhenTheStreamEndedIsNotSentOnTheNextOne) {
  ASSERT_NO_FATAL_FAILURE(BlockTheWriter());
  asking_ = std::thread([this] {
    EXPECT_THAT(stream_.Ask({}), StatusIs(absl::StatusCode::kUnavailable, testing::HasSubstr("ended the stream")));
  });
  absl::SleepFor(absl::Milliseconds(200));
  service_.EndStream();
  service_.ResumeReading();
  asking_.join();
  EXPECT_FALSE(WaitUntil([this] { return service_.order() != "pf"; }, absl::Milliseconds(300))) << service_.order();
  EXPECT_THAT(stream_.Ask({}), IsOk());
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_EQ(service_.order(), "pfpf");
}

TEST_F(LearnerStreamTest, StopDoesNotWaitForVerdicts) {
  service_.Script({Answer::kSilence});
  Start();
  Push(0, 0);
  ASSERT_TRUE(WaitUntil([this] { return !service_.received().empty(); }));
  // The queue holds 64: this one blocks until Stop.
  absl::Status blocked;
  std::thread pusher([&] {
    for (int64_t number = 1; blocked.ok(); ++number) blocked = stream_.Push(SampleFragment(1, number, 5));
  });
  const absl::Time start = absl::Now();
  stream_.Stop();
  EXPECT_LT(absl::Now() - start, absl::Seconds(3));
  pusher.join();
  EXPECT_THAT(blocked, StatusIs(absl::StatusCode::kCancelled, "stopping"));
  EXPECT_THAT(stream_.Ask({}), StatusIs(absl::StatusCode::kCancelled, "stopping"));
  stream_.Stop();
}

TEST_F(LearnerStreamTest, StopsWhileTheLearnerIsUnreachable) {
  StopLearner();
  Start();
  Push(0, 0);
  absl::SleepFor(absl::Milliseconds(50));
  const absl::Time start = absl::Now();
  stream_.Stop();
  EXPECT_LT(absl::Now() - start, absl::Seconds(3));
}

}  // namespace
}  // namespace craftfleet
