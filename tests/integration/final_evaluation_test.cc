// The end of a run with real processes: the final evaluation, stopped and resumed, and extended runs.

#include <csignal>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/fakes/wait_until.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

constexpr char kEvaluating[] = "training is over; waiting for the remaining evaluations";

class FinalEvaluationTest : public SmallRunTest {
 protected:
  // Configures the small run with a final evaluation of `episodes` of each kind.
  void EvaluateAtTheEnd(int episodes) {
    const std::string text =
        absl::StrReplaceAll(kConfig, {{"final_episodes: 0", absl::StrCat("final_episodes: ", episodes)}});
    ASSERT_THAT(WriteFileSynced(config(), text), IsOk());
  }
  void ExpectStopped(const Ended& ended, const std::string& run) {
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
    EXPECT_THAT(ended.err, HasSubstr("stopped during the final evaluation; continue with --resume"));
    EXPECT_THAT(ended.err, Not(HasSubstr("the run is complete")));
    EXPECT_EQ(Text(run, "final_argmax.jsonl"), "");
    EXPECT_EQ(Text(run, "final_sampled.jsonl"), "");
    EXPECT_TRUE(PathExists(Checkpoint(run, 3)));
  }
  void ExpectSameFinalLogs(const std::string& run, const std::string& other) {
    for (const char* log : {"final_argmax.jsonl", "final_sampled.jsonl", "stats.jsonl"}) {
      EXPECT_EQ(Text(run, log), Text(other, log)) << log;
    }
  }
  Ended Resume(const std::string& run, const std::vector<std::string>& more = {}) {
    std::vector<std::string> flags = {"--resume", "--logdir=" + Logdir(run)};
    flags.insert(flags.end(), more.begin(), more.end());
    const Ended ended = Run("craftfleet train", flags);
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
    EXPECT_THAT(ended.err, HasSubstr("the run is complete"));
    return ended;
  }
};

TEST_F(FinalEvaluationTest, StoppedByASignalItIsNotCompleteAndResumes) {
  ASSERT_NO_FATAL_FAILURE(EvaluateAtTheEnd(100));
  Train("quiet");
  const auto train = Start("craftfleet train", Flags("run"));
  ASSERT_TRUE(train->WaitForText(kEvaluating, kPatience)) << train->Err();
  train->Signal(SIGTERM);
  ExpectStopped(Finish(train.get()), "run");
  EXPECT_THAT(Resume("run").err, HasSubstr(kEvaluating));
  ExpectSameFinalLogs("run", "quiet");
  EXPECT_THAT(Resume("run").err, Not(HasSubstr(kEvaluating))) << "nothing is left to do";
}

TEST_F(FinalEvaluationTest, StoppedByAdminItIsNotCompleteAndTheStatusShowsIt) {
  ASSERT_NO_FATAL_FAILURE(EvaluateAtTheEnd(50));
  Train("quiet");
  auto learner = Start("craftfleet-learner", Flags("run", {"--listen=127.0.0.1:0"}));
  const auto server = Start("craftfleet-envserver", {"--listen=127.0.0.1:0"});
  const std::string address = learner->WaitForAddress("listening on ", kPatience).value();
  const auto actor =
      Start("craftfleet-actor",
            {"--learner=" + address, "--envservers=" + server->WaitForAddress("listening on ", kPatience).value()});
  const auto state = [&] {
    const auto status =
        nlohmann::json::parse(Run("craftfleet status", {"--address=" + address, "--json"}).out, nullptr, false);
    return status.is_object() ? status["fleet"].value("run_state", "none") : "no status";
  };
  ASSERT_TRUE(learner->WaitForText(kEvaluating, kPatience)) << learner->Err();
  actor->Signal(SIGSTOP);
  EXPECT_EQ(state(), "EVALUATING");
  const Ended stop = Run("craftfleet admin", {"stop", "--address=" + address});
  EXPECT_EQ(stop.exit_code, 0) << stop.err;
  EXPECT_THAT(stop.out, HasSubstr("the learner is stopping"));
  ExpectStopped(Finish(learner.get()), "run");

  actor->Signal(SIGCONT);
  learner = Start("craftfleet-learner", {"--resume", "--logdir=" + Logdir("run"), "--listen=" + address});
  const Ended ended = Finish(learner.get());
  EXPECT_EQ(ended.exit_code, 0) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("the run is complete"));
  EXPECT_EQ(Finish(actor.get()).exit_code, 0) << actor->Err();
  ExpectSameFinalLogs("run", "quiet");
}

TEST_F(FinalEvaluationTest, AnExtendedRunHasTheFinalEvaluationOfItsNewestWeights) {
  ASSERT_NO_FATAL_FAILURE(EvaluateAtTheEnd(3));
  CopyTrained("run");
  CopyTrained("short");
  EXPECT_EQ(Run("craftfleet train", Flags("long", {"--steps=320"})).exit_code, 0);
  Resume("run", {"--steps=320"});
  ExpectSameFinalLogs("run", "long");
  for (const std::string kind : {"argmax", "sampled"}) {
    EXPECT_EQ(Text("run", "final_" + kind + "-192.jsonl"), Text("short", "final_" + kind + ".jsonl"));
  }
  Resume("run", {"--steps=192", "--resume_from=iter-00000003"});
  ExpectSameFinalLogs("run", "short");
  EXPECT_EQ(Text("run", "final_argmax-192.jsonl"), "none");
}

}  // namespace
}  // namespace craftfleet
