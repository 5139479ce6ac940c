#include "actor/fragment_sender.h"

#include <memory>
#include <string>
#include <thread>
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

// A sender with a fake learner.
class FragmentSenderTest : public testing::Test {
 protected:
  FragmentSenderTest() : client_(wire::Connect(address())) { StartLearner(); }

  std::string address() const { return "unix:" + (folder_ / "learner"); }
  void StartLearner() { learner_ = *wire::Server::Create({address()}, {&service_}); }
  void StopLearner() { learner_.reset(); }

  HeldPermit PermitOf(int lane, int64_t number) { return {{lane, number, 5}, 1}; }
  // Pushes a fragment for which there is a permit.
  void Push(int lane, int64_t number) {
    permits_.Add(PermitOf(lane, number));
    EXPECT_THAT(sender_.Push(SampleFragment(lane, number, 5)), IsOk());
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
  FragmentSender sender_{&client_, "an actor", &permits_};
};

TEST_F(FragmentSenderTest, SendsFragmentsInOrderAndReleasesTheirPermits) {
  sender_.Start();
  for (int lane = 0; lane < 5; ++lane) Push(lane, 0);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1, 2, 3, 4));
  EXPECT_EQ(sender_.accepted(), 5);
  EXPECT_EQ(sender_.resent(), 0);
  v1::FragmentMessage third = service_.received()[2];
  EXPECT_EQ(third.actor(), "an actor");
  ExpectSameFragments(*wire::FromProto(&third, kSampleShape), SampleFragment(2, 0, 5));
}

TEST_F(FragmentSenderTest, ResendsFragmentsWithoutAVerdictAfterTheStreamBreaks) {
  service_.Script({Answer::kAccept, Answer::kBreak, Answer::kBreak});
  sender_.Start();
  for (int lane = 0; lane < 3; ++lane) Push(lane, 0);
  ASSERT_TRUE(WaitUntil([this] { return sender_.resent() >= 1; }));
  EXPECT_EQ(permits_.Active().front().lane, 1) << "its permit is held until the verdict";
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1, 1, 1, 2));
  EXPECT_EQ(service_.received()[3].SerializeAsString(), service_.received()[1].SerializeAsString());
  EXPECT_EQ(sender_.accepted(), 3);
  EXPECT_GE(sender_.resent(), 2) << "the last one may also have been sent";
}

TEST_F(FragmentSenderTest, SendsABoundedNumberBeforeTheFirstVerdict) {
  service_.Script(std::vector<Answer>(20, Answer::kSilence));
  sender_.Start();
  for (int lane = 0; lane < 20; ++lane) Push(lane, 0);
  EXPECT_TRUE(WaitUntil([this] { return service_.received().size() == 16; }));
  EXPECT_FALSE(WaitUntil([this] { return service_.received().size() > 16; }, absl::Milliseconds(200)));
  EXPECT_EQ(permits_.Active().size(), 20);
}

TEST_F(FragmentSenderTest, WaitsForAnUnreachableLearner) {
  StopLearner();
  sender_.Start();
  Push(0, 0);
  Push(1, 0);
  EXPECT_FALSE(WaitUntil([this] { return permits_.Active().size() < 2; }, absl::Milliseconds(300)));
  StartLearner();
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1));
}

TEST_F(FragmentSenderTest, ContinuesAfterTheLearnerReturns) {
  sender_.Start();
  Push(0, 0);
  ASSERT_TRUE(WaitForVerdicts());
  StopLearner();
  StartLearner();
  Push(0, 1);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_EQ(sender_.accepted(), 2);
}

TEST_F(FragmentSenderTest, DropWaitingDropsUnsentFragments) {
  service_.Script(std::vector<Answer>(16, Answer::kSilence));
  sender_.Start();
  for (int lane = 0; lane < 20; ++lane) Push(lane, 0);
  ASSERT_TRUE(WaitUntil([this] { return service_.received().size() == 16; }));
  sender_.DropWaiting();
  EXPECT_EQ(permits_.Active().size(), 16) << "those under way get a verdict";
}

TEST_F(FragmentSenderTest, EveryVerdictReleasesThePermit) {
  service_.Script({Answer::kDuplicate, Answer::kExpire});
  sender_.Start();
  Push(0, 0);
  Push(1, 0);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_EQ(sender_.accepted(), 1) << "it was accepted the first time";
  EXPECT_EQ(sender_.refused(), 1);
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1));
}

TEST_F(FragmentSenderTest, DropsAFragmentThatTheLearnerRefuses) {
  service_.Script({Answer::kRefuse});
  sender_.Start();
  Push(0, 0);
  Push(1, 0);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_EQ(sender_.refused(), 1);
  EXPECT_EQ(sender_.accepted(), 1);
  EXPECT_THAT(LanesReceived(), ElementsAre(0, 1));
}

TEST_F(FragmentSenderTest, AVerdictOnAnotherFragmentIsAnError) {
  service_.Script({Answer::kWrongVerdict});
  sender_.Start();
  Push(0, 0);
  ASSERT_TRUE(WaitForVerdicts());
  EXPECT_EQ(sender_.accepted(), 1);
  EXPECT_EQ(sender_.resent(), 1);
}

TEST_F(FragmentSenderTest, StopDoesNotWaitForVerdicts) {
  service_.Script({Answer::kSilence});
  sender_.Start();
  Push(0, 0);
  ASSERT_TRUE(WaitUntil([this] { return !service_.received().empty(); }));
  // The queue holds 64: this one blocks until Stop.
  absl::Status blocked;
  std::thread pusher([&] {
    for (int64_t number = 1; blocked.ok(); ++number) blocked = sender_.Push(SampleFragment(1, number, 5));
  });
  const absl::Time start = absl::Now();
  sender_.Stop();
  EXPECT_LT(absl::Now() - start, absl::Seconds(3));
  pusher.join();
  EXPECT_THAT(blocked, StatusIs(absl::StatusCode::kCancelled, "stopping"));
  sender_.Stop();
}

TEST_F(FragmentSenderTest, StopsWhileTheLearnerIsUnreachable) {
  StopLearner();
  sender_.Start();
  Push(0, 0);
  absl::SleepFor(absl::Milliseconds(50));
  const absl::Time start = absl::Now();
  sender_.Stop();
  EXPECT_LT(absl::Now() - start, absl::Seconds(3));
}

}  // namespace
}  // namespace craftfleet
