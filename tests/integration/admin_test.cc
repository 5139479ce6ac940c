// Admin commands do not change a run's result.

#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class AdminTest : public FleetRunTest {
 protected:
  struct Ended {
    int exit_code = -1;
    std::string out;
    std::string err;
  };
  Ended Admin(std::vector<std::string> arguments) {
    arguments.push_back("--address=" + fleet_.address);
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
  // A fleet within a run.
  void StartRun(const std::string& run) {
    fleet_ = StartFleet(run, /*registers=*/true);
    WaitForCheckpoint(run, 2);
  }
  void ExpectGoingOn() const { EXPECT_FALSE(fleet_.learner->Wait(absl::ZeroDuration()).has_value()) << "too early"; }
  void ExpectTheRunToEndLikeQuiet(const std::string& run) { ExpectCompleteLikeQuiet(run, fleet_.learner.get()); }

  Fleet fleet_;
  int calls_ = 0;
};

TEST_F(AdminTest, ARunPausedAndResumedFromARequestedCheckpointHasTheSameResult) {
  StartRun("paused");
  Order({"pause"}, "paused");
  Order({"checkpoint"}, "checkpoint of iteration ");
  fleet_.RestartLearner("paused");
  WaitForCheckpoint("paused", 4);
  Order({"pause"}, "paused");
  Order({"checkpoint"}, "checkpoint of iteration ");
  const std::string stats = ReadFile(Logdir("paused") + "/stats.jsonl").value_or("");
  absl::SleepFor(absl::Seconds(2));  // enough for five iterations
  EXPECT_EQ(ReadFile(Logdir("paused") + "/stats.jsonl").value_or("none"), stats);
  ExpectGoingOn();
  Order({"resume"}, "resumed");
  Order({"resume"}, "the run was not paused");
  Order({"checkpoint"}, "checkpoint of iteration ");
  ExpectTheRunToEndLikeQuiet("paused");
  EXPECT_THAT(fleet_.learner->Err(),
              AllOf(HasSubstr("admin ipv4:127.0.0.1:"), HasSubstr(": pause"), HasSubstr(": resume")));
}

TEST_F(AdminTest, ADrainedActorNoLongerPlays) {
  StartRun("drained");
  const auto second = StartActor("drained-actor2", fleet_.address, "learner");
  const std::string first = StatusAddress(*fleet_.actor);
  Order({"drain", first}, "actor " + first + " is drained");
  fleet_.actor->Kill();  // it has no work left
  ExpectGoingOn();
  ExpectTheRunToEndLikeQuiet("drained");
  EXPECT_EQ(second->Wait(absl::Seconds(10)), 0) << second->Err();
  EXPECT_THAT(second->Err(), Not(HasSubstr("lapsed")));
}

TEST_F(AdminTest, AnUndrainedActorFinishesTheRun) {
  StartRun("undrained");
  const std::string address = StatusAddress(*fleet_.actor);
  Order({"drain", address}, "actor " + address + " is drained");
  ExpectGoingOn();
  Order({"undrain", address}, "actor " + address + " gets work again");
  ExpectTheRunToEndLikeQuiet("undrained");
}

TEST_F(AdminTest, ADrainedServerHasNoGames) {
  StartRun("emptied");
  const auto second = StartRegisteredServer("emptied-server2", fleet_.address);
  ASSERT_TRUE(second->WaitForText("registered with learner", kPatience));
  Order({"drain", fleet_.server_address}, "envserver " + fleet_.server_address + " is drained");
  fleet_.server->Kill();
  ExpectGoingOn();
  ExpectTheRunToEndLikeQuiet("emptied");
  EXPECT_THAT(fleet_.actor->Err(), Not(HasSubstr("ended the session")));
}

TEST_F(AdminTest, ErrorsNameTheProblem) {
  fleet_.learner = StartLearner("wrong", "127.0.0.1:0");
  fleet_.address = fleet_.learner->WaitForAddress().value();
  EXPECT_THAT(Admin({"dance"}).err, HasSubstr("\"dance\" is not a command, want checkpoint, pause"));
  EXPECT_THAT(Admin({"drain"}).err, HasSubstr("drain needs the name of one worker"));
  EXPECT_THAT(Admin({"undrain"}).err, HasSubstr("undrain needs the name of one worker"));
  EXPECT_THAT(Admin({"undrain", "nobody"}).err, HasSubstr("no worker \"nobody\" has joined or registered"));
  EXPECT_THAT(Admin({"drain", "nobody"}).err, HasSubstr("no worker \"nobody\" has joined or registered"));
  EXPECT_THAT(Admin({"pause", "--timeout=0"}).err, HasSubstr("--timeout=0, want more than 0"));
  fleet_.learner->Kill();
  EXPECT_THAT(Admin({"pause"}).err, HasSubstr("learner " + fleet_.address + ": cannot connect"));
}

}  // namespace
}  // namespace craftfleet
