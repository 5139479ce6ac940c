// Workers that would compute otherwise than the rest of their run: refused, let in when told to, or pinned.

#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/cpu_pin.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

// What makes a process compute like one on a CPU of 2005.
const std::vector<std::string>& OldCpu() {
  static const auto& variables =
      *new std::vector<std::string>{"ATEN_CPU_CAPABILITY=default", "ONEDNN_MAX_CPU_ISA=SSE41", "DNNL_MAX_CPU_ISA=SSE41",
                                    "OPENBLAS_CORETYPE=Prescott"};
  return variables;
}

class MixedBuildsTest : public SmallRunTest {
 protected:
  void SetUp() override {
    if (!CheckCpu(v1::RunConfig::AVX2).ok()) GTEST_SKIP() << "a CPU without AVX2";
  }

  // `program` in an environment with `variables` too.
  std::unique_ptr<Process> StartWith(std::vector<std::string> variables, const std::string& program,
                                     const std::vector<std::string>& flags) {
    variables.push_back(CRAFTFLEET_BIN_DIR "/" + program);
    variables.insert(variables.end(), flags.begin(), flags.end());
    return Start("/usr/bin/env", variables);
  }
  void StartFleet(const std::string& run, const std::vector<std::string>& flags) {
    std::vector<std::string> more = flags;
    more.push_back("--listen=127.0.0.1:0");
    learner_ = Start("craftfleet-learner", Flags(run, more));
    address_ = learner_->WaitForAddress("listening on ", kPatience).value();
    server_ = Start("craftfleet-envserver", {"--listen=127.0.0.1:0", "--learner=" + address_});
  }
  std::vector<std::string> ActorFlags() const {
    return {"--learner=" + address_, "--envservers=learner", "--threads=1"};
  }
  std::string Status() { return Run("craftfleet-status", {"--address=" + address_}).out; }
  std::string Weights(const std::string& run) const {
    return ReadFile(JoinPath(Checkpoint(run, 3), "weights.safetensors")).value_or("none of " + run);
  }

  std::unique_ptr<Process> learner_;
  std::unique_ptr<Process> server_;
  std::string address_;
};

TEST_F(MixedBuildsTest, AnActorThatComputesOtherwiseIsRefusedAndNamed) {
  StartFleet("refused", {});
  const auto odd = StartWith(OldCpu(), "craftfleet-actor", ActorFlags());
  EXPECT_EQ(odd->Wait(kPatience), 1);
  EXPECT_THAT(odd->Err(), AllOf(HasSubstr("computes other numbers than this learner"), HasSubstr("--cpu=avx2"),
                                HasSubstr("--allow_mixed")));
  EXPECT_THAT(learner_->Err(), HasSubstr("computes other numbers than this learner"));
  EXPECT_THAT(Status(), HasSubstr("refused: another canary"));
  // The run is the others'.
  const auto actor = Start("craftfleet-actor", ActorFlags());
  EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
  EXPECT_EQ(actor->Wait(kPatience), 0) << actor->Err();
  Train("quiet");
  EXPECT_TRUE(Weights("refused") == Weights("quiet"));
}

TEST_F(MixedBuildsTest, WithAllowMixedItPlays) {
  StartFleet("mixed", {"--allow_mixed"});
  const auto odd = StartWith(OldCpu(), "craftfleet-actor", ActorFlags());
  EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
  EXPECT_EQ(odd->Wait(kPatience), 0) << odd->Err();
  EXPECT_THAT(learner_->Err(), HasSubstr("let in by --allow_mixed: the result depends on who plays"));
}

TEST_F(MixedBuildsTest, APinnedRunIsTheSameWhateverEachMachineWouldChoose) {
  const Ended alone = Run("craftfleet-train", Flags("alone", {"--cpu=avx2"}));
  ASSERT_EQ(alone.exit_code, 0) << alone.err;
  EXPECT_THAT(ReadFile(JoinPath(Logdir("alone"), "config.txt")).value_or(""), HasSubstr("cpu: AVX2"));
  EXPECT_THAT(alone.err, Not(HasSubstr("the canary is")));
  StartFleet("pinned", {"--cpu=avx2"});
  const auto odd = StartWith(OldCpu(), "craftfleet-actor", ActorFlags());
  const auto plain = Start("craftfleet-actor", ActorFlags());
  EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
  EXPECT_EQ(odd->Wait(kPatience), 0) << odd->Err();
  EXPECT_EQ(plain->Wait(kPatience), 0) << plain->Err();
  EXPECT_TRUE(Weights("pinned") == Weights("alone"));
  // And so is what goes on with it, without the flag.
  const Ended resumed = Run("craftfleet-train", {"--logdir=" + Logdir("alone"), "--resume", "--steps=256"});
  EXPECT_EQ(resumed.exit_code, 0) << resumed.err;
  const Ended refused = Run("craftfleet-train", {"--logdir=" + Logdir("alone"), "--resume", "--cpu=native"});
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err, HasSubstr("cpu"));
}

}  // namespace
}  // namespace craftfleet
