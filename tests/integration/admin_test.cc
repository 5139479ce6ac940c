// Admin commands do not change a run's result.

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/wait_until.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class AdminTest : public FleetRunTest {
 protected:
  // Starts a learner and `servers` environment servers that register with it. Actors of StartActor play on these.
  void StartFleet(const std::string& run, int servers = 1) {
    learner_ = StartLearner(run, "127.0.0.1:0");
    address_ = learner_->WaitForAddress("listening on ", kPatience).value();
    for (int i = 0; i < servers; ++i) {
      servers_.push_back(Start("craftfleet-envserver", absl::StrCat(run, "-server", i),
                               {"--listen=127.0.0.1:0", "--learner=" + address_}));
    }
  }
  std::unique_ptr<Process> Play(const std::string& log) { return StartActor(log, address_, "learner"); }

  struct Ended {
    int exit_code = -1;
    std::string out;
    std::string err;
  };
  Ended Admin(std::vector<std::string> arguments) {
    arguments.push_back("--address=" + address_);
    const auto process = Start("craftfleet admin", absl::StrCat("admin-", ++calls_), arguments);
    const int exit_code = process->Wait(kPatience).value_or(-1);
    return {exit_code, process->Out(), process->Err()};
  }
  void Order(std::vector<std::string> arguments, const std::string& answer) {
    const Ended ended = Admin(std::move(arguments));
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
    EXPECT_THAT(ended.out, HasSubstr(answer));
  }
  // The address of an actor's status service, which can also name the actor.
  static std::string StatusAddress(const Process& actor) {
    return actor.WaitForAddress("status on ", kPatience).value();
  }
  void ExpectTheRunToEndLikeQuiet(const std::string& run) {
    EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
    ExpectLikeQuiet(run);
  }

  std::unique_ptr<Process> learner_;
  std::vector<std::unique_ptr<Process>> servers_;
  std::string address_;
  int calls_ = 0;
};

TEST_F(AdminTest, APausedAndCheckpointedRunHasTheSameResult) {
  StartFleet("paused");
  const auto actor = Play("paused-actor");
  WaitForCheckpoint("paused", 2);
  Order({"pause"}, "paused");
  Order({"checkpoint"}, "checkpoint of iteration ");
  const std::string stats = ReadFile(Logdir("paused") + "/stats.jsonl").value_or("");
  absl::SleepFor(absl::Seconds(2));  // enough for five iterations
  EXPECT_EQ(ReadFile(Logdir("paused") + "/stats.jsonl").value_or("none"), stats);
  EXPECT_FALSE(learner_->Wait(absl::ZeroDuration()).has_value());
  Order({"resume"}, "resumed");
  Order({"resume"}, "the run was not paused");
  Order({"checkpoint"}, "checkpoint of iteration ");
  ExpectTheRunToEndLikeQuiet("paused");
  EXPECT_THAT(learner_->Err(), AllOf(HasSubstr("admin ipv4:127.0.0.1:"), HasSubstr(": pause"), HasSubstr(": resume")));
}

TEST_F(AdminTest, ARequestedCheckpointCanBeResumedFrom) {
  StartFleet("asked");
  const auto actor = Play("asked-actor");
  WaitForCheckpoint("asked", 2);
  Order({"pause"}, "paused");
  Order({"checkpoint"}, "checkpoint of iteration ");
  learner_->Kill();
  learner_ = StartLearner("asked", address_, {"--resume"});
  ExpectTheRunToEndLikeQuiet("asked");
}

TEST_F(AdminTest, ADrainedActorNoLongerPlays) {
  StartFleet("drained");
  const auto first = Play("drained-actor1");
  const auto second = Play("drained-actor2");
  WaitForCheckpoint("drained", 2);
  Order({"drain", StatusAddress(*first)}, "actor " + StatusAddress(*first) + " is drained");
  first->Kill();  // it has no work left
  EXPECT_FALSE(learner_->Wait(absl::ZeroDuration()).has_value()) << "the run ended before the drain";
  ExpectTheRunToEndLikeQuiet("drained");
  EXPECT_EQ(second->Wait(absl::Seconds(10)), 0) << second->Err();
  EXPECT_THAT(second->Err(), Not(HasSubstr("lapsed")));
}

TEST_F(AdminTest, AnUndrainedActorFinishesTheRun) {
  StartFleet("undrained");
  const auto actor = Play("undrained-actor");
  WaitForCheckpoint("undrained", 2);
  const std::string address = StatusAddress(*actor);
  Order({"drain", address}, "actor " + address + " is drained");
  EXPECT_FALSE(learner_->Wait(absl::ZeroDuration()).has_value()) << "the run ended before the drain";
  Order({"undrain", address}, "actor " + address + " gets work again");
  ExpectTheRunToEndLikeQuiet("undrained");
}

TEST_F(AdminTest, ADrainedServerHasNoGames) {
  StartFleet("emptied", /*servers=*/2);
  const auto actor = Play("emptied-actor");
  const std::string server = servers_[0]->WaitForAddress("listening on ", kPatience).value();
  WaitForCheckpoint("emptied", 2);
  Order({"drain", server}, "envserver " + server + " is drained");
  servers_[0]->Kill();
  EXPECT_FALSE(learner_->Wait(absl::ZeroDuration()).has_value()) << "the run ended before the drain";
  ExpectTheRunToEndLikeQuiet("emptied");
  EXPECT_THAT(actor->Err(), Not(HasSubstr("ended the session")));
}

TEST_F(AdminTest, AStoppedLearnerContinuesWithResume) {
  StartFleet("stopped");
  const auto actor = Play("stopped-actor");
  WaitForCheckpoint("stopped", 2);
  Order({"stop"}, "the learner is stopping");
  EXPECT_EQ(learner_->Wait(absl::Seconds(10)), 0) << learner_->Err();
  EXPECT_THAT(learner_->Err(), HasSubstr("continue with --resume"));
  learner_ = StartLearner("stopped", address_, {"--resume"});
  ExpectTheRunToEndLikeQuiet("stopped");
}

TEST_F(AdminTest, ErrorsNameTheProblem) {
  StartFleet("wrong");
  EXPECT_THAT(Admin({"dance"}).err, HasSubstr("\"dance\" is not a command, want checkpoint, pause"));
  EXPECT_THAT(Admin({"drain"}).err, HasSubstr("drain needs the name of one worker"));
  EXPECT_THAT(Admin({"undrain"}).err, HasSubstr("undrain needs the name of one worker"));
  EXPECT_THAT(Admin({"undrain", "nobody"}).err, HasSubstr("no worker \"nobody\" has joined or registered"));
  EXPECT_THAT(Admin({"drain", "nobody"}).err, HasSubstr("no worker \"nobody\" has joined or registered"));
  EXPECT_THAT(Admin({"pause", "--timeout=0"}).err, HasSubstr("--timeout=0, want more than 0"));
  learner_->Kill();
  EXPECT_THAT(Admin({"pause"}).err, HasSubstr("learner " + address_ + ": cannot connect"));
}

}  // namespace
}  // namespace craftfleet
