// Environment servers that are stopped again and again, as on a host that swaps: the fleet goes on, and they are named.

#include <atomic>
#include <csignal>
#include <memory>
#include <string>
#include <thread>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/wait_until.h"
#include "tests/integration/ask_status.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

// Stops a process for `off` of each `off` + `on`, until it is destroyed.
class Stutter {
 public:
  Stutter(Process* process, absl::Duration off, absl::Duration on)
      : thread_([=] {
          while (!done_) {
            process->Signal(SIGSTOP);
            absl::SleepFor(off);
            process->Signal(SIGCONT);
            absl::SleepFor(on);
          }
        }) {}
  ~Stutter() {
    done_ = true;
    thread_.join();
  }

 private:
  std::atomic<bool> done_{false};
  std::thread thread_;
};

// In which an actor learns how long steps usually take: a window of StepTimes and more.
constexpr absl::Duration kUntilKnown = absl::Seconds(4);
constexpr absl::Duration kWindow = absl::Seconds(8);  // in which the step rate is measured
constexpr double kMost = 0.7;                         // of the undisturbed rate

// A run that does not end during a test.
constexpr char kLongRun[] = R"(
  steps: 100000000  lanes: 8  seed: 3  fragment_steps: 64
  env { length: 200 }
  ppo { rollout_steps: 512  minibatch_size: 256  epochs: 1 }
  checkpoint { every_iterations: 1000 }
)";

class SlowServersTest : public FleetRunTest {
 protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(Configure(kLongRun));
    learner_ = StartLearner("slow", "127.0.0.1:0");
    learner_address_ = learner_->WaitForAddress().value();
    first_ = StartServer("first");
    second_ = StartServer("second");
  }
  void StartActorOn(const std::string& servers) {
    actor_ = StartActor("actor", learner_address_, servers, 1);
    ASSERT_TRUE(WaitUntil([&] { return Steps() > 0; }, kPatience)) << actor_->Err();
  }
  double Steps() const { return MetricOf(learner_address_, "env_steps"); }
  double RateOver(absl::Duration duration) const {
    const double before = Steps();
    const absl::Time begin = absl::Now();
    absl::SleepFor(duration);
    return (Steps() - before) / absl::ToDoubleSeconds(absl::Now() - begin);
  }
  std::string Advice() const {
    const absl::StatusOr<v1::StatusReply> status = AskStatus(learner_address_);
    return status.ok() ? status->fleet().advice() : "";
  }
  bool BecomesSlow(const std::string& address) const {
    return WaitUntil([&] { return HealthOf(address) == v1::Peer::SLOW; }, kPatience);
  }
  // The health of the server at `address`, as the learner shows it.
  v1::Peer::Health HealthOf(const std::string& address) const {
    absl::SleepFor(absl::Milliseconds(200));  // called again and again
    const absl::StatusOr<v1::StatusReply> status = AskStatus(learner_address_);
    if (!status.ok()) return v1::Peer::HEALTH_UNSPECIFIED;
    for (const v1::Peer& peer : status->peers()) {
      if (peer.address() == address) return peer.health();
    }
    return v1::Peer::HEALTH_UNSPECIFIED;
  }

  std::string learner_address_;
  std::unique_ptr<Process> learner_;
  std::unique_ptr<Process> first_;
  std::unique_ptr<Process> second_;
  std::unique_ptr<Process> actor_;
};

// It is named, and the fleet soon has most of its speed.
TEST_F(SlowServersTest, AServerStoppedForMostOfEachSecondLosesItsGames) {
  const std::string slow = second_->WaitForAddress().value();
  StartActorOn(first_->WaitForAddress().value() + "," + slow);
  absl::SleepFor(kUntilKnown);
  const double before = RateOver(kWindow);
  double rate = 0;
  {
    const Stutter stutter(second_.get(), absl::Milliseconds(950), absl::Milliseconds(50));
    ASSERT_TRUE(BecomesSlow(slow)) << actor_->Err();
    absl::SleepFor(absl::Seconds(4));  // its games have moved, and its first probe falls into what is measured
    // Again if it was low, since the machine may also do other things.
    for (int i = 0; i < 3 && rate < kMost * before; ++i) rate = RateOver(kWindow);
    EXPECT_THAT(actor_->Err(), HasSubstr("environment server " + slow + " is slow: a step takes "));
    EXPECT_THAT(learner_->Err(), HasSubstr("environment server " + slow + " is slow: a step takes "));
    EXPECT_EQ(HealthOf(slow), v1::Peer::SLOW);
    EXPECT_THAT(Advice(), HasSubstr("Environment server " + slow));
  }
  EXPECT_TRUE(WaitUntil([&] { return HealthOf(slow) == v1::Peer::OK; }, kPatience)) << "it is tried again";
  EXPECT_THAT(Advice(), Not(HasSubstr(slow)));
  if (rate >= kMost * before) return;
  // It may also have done less before.
  EXPECT_GE(rate, kMost * RateOver(kWindow)) << before << " steps/s before";
}

TEST_F(SlowServersTest, TheOnlyServerIsNamedAndKeepsItsGames) {
  const std::string slow = first_->WaitForAddress().value();
  StartActorOn(slow);
  absl::SleepFor(kUntilKnown);
  {
    const Stutter stutter(first_.get(), absl::Milliseconds(950), absl::Milliseconds(50));
    EXPECT_TRUE(BecomesSlow(slow)) << actor_->Err();
    EXPECT_THAT(Advice(), HasSubstr("Environment server " + slow));
    EXPECT_THAT(actor_->Err(), HasSubstr("environment server " + slow + " is slow"));
    EXPECT_THAT(actor_->Err(), Not(HasSubstr("fragments returned")));
    const double before = Steps();
    EXPECT_TRUE(WaitUntil([&] { return Steps() > before; }, kPatience)) << "it still plays";
  }
  EXPECT_TRUE(WaitUntil([&] { return HealthOf(slow) == v1::Peer::OK; }, kPatience));
}

TEST_F(SlowServersTest, AnActorThatIsStoppedBlamesNoServer) {
  StartActorOn(first_->WaitForAddress().value() + "," + second_->WaitForAddress().value());
  absl::SleepFor(kUntilKnown);
  const Stutter stutter(actor_.get(), absl::Milliseconds(950), absl::Milliseconds(50));
  const double before = Steps();
  absl::SleepFor(absl::Seconds(8));  // two windows of StepTimes and more
  EXPECT_TRUE(WaitUntil([&] { return Steps() > before; }, kPatience)) << "it still plays: " << actor_->Err();
  EXPECT_THAT(actor_->Err(), Not(HasSubstr("is slow")));
}

}  // namespace
}  // namespace craftfleet
