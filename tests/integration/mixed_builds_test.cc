// Workers with numerics other than the rest of their run: refused, accepted with --allow_mixed, or pinned.

#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include "common/io/texture_digest.h"
#include "common/process/cpu_pin.h"
#include "common/wire/protocol.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "tests/integration/ask_status.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::SizeIs;

// Environment variables that make a process compute as on a CPU of 2005.
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

  // Starts `program` with additional environment `variables`.
  std::unique_ptr<Process> StartWith(std::vector<std::string> variables, const std::string& program,
                                     const std::vector<std::string>& flags) {
    const std::vector<std::string> command = BuiltCommand(program);
    variables.insert(variables.end(), command.begin(), command.end());
    variables.insert(variables.end(), flags.begin(), flags.end());
    return Start("/usr/bin/env", variables);
  }
  void StartLearner(const std::string& run, const std::vector<std::string>& flags) {
    std::vector<std::string> more = flags;
    more.push_back("--listen=127.0.0.1:0");
    learner_ = Start("craftfleet-learner", Flags(run, more));
    address_ = learner_->WaitForAddress("listening on ", kPatience).value();
  }
  void StartServer() { server_ = Start("craftfleet-envserver", {"--listen=127.0.0.1:0", "--learner=" + address_}); }
  void StartFleet(const std::string& run, const std::vector<std::string>& flags) {
    StartLearner(run, flags);
    StartServer();
  }
  std::vector<std::string> ActorFlags() const {
    return {"--learner=" + address_, "--envservers=learner", "--threads=1"};
  }
  std::string Status() { return Run("craftfleet status", {"--address=" + address_}).out; }
  std::string Weights(const std::string& run) const {
    return ReadFile(JoinPath(Checkpoint(run, 3), "weights.safetensors")).value_or("none of " + run);
  }

  std::unique_ptr<Process> learner_;
  std::unique_ptr<Process> server_;
  std::string address_;
};

TEST_F(MixedBuildsTest, AnActorWithOtherNumericsIsRefusedAndNamed) {
  StartFleet("refused", {});
  const auto odd = StartWith(OldCpu(), "craftfleet-actor", ActorFlags());
  EXPECT_EQ(odd->Wait(kPatience), 1);
  EXPECT_THAT(odd->Err(), AllOf(HasSubstr("computes different results from this learner"), HasSubstr("--cpu=avx2"),
                                HasSubstr("--allow_mixed")));
  EXPECT_THAT(learner_->Err(), HasSubstr("computes different results from this learner"));
  EXPECT_THAT(Status(), HasSubstr("refused: another canary"));
  // The other actors play the run.
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
  EXPECT_THAT(learner_->Err(),
              HasSubstr("accepted because of --allow_mixed: the result depends on which workers play"));
}

TEST_F(MixedBuildsTest, APinnedRunIsTheSameOnEveryMachine) {
  const Ended alone = Run("craftfleet train", Flags("alone", {"--cpu=avx2"}));
  ASSERT_EQ(alone.exit_code, 0) << alone.err;
  EXPECT_THAT(ReadFile(JoinPath(Logdir("alone"), "config.txt")).value_or(""), HasSubstr("cpu: AVX2"));
  EXPECT_THAT(alone.err, Not(HasSubstr("the canary is")));
  StartLearner("pinned", {"--cpu=avx2"});
  const auto odd = StartWith(OldCpu(), "craftfleet-actor", ActorFlags());
  const auto plain = Start("craftfleet-actor", ActorFlags());
  // Without a server the run can't end before the one that restarts is back.
  for (const auto& actor : {odd.get(), plain.get()}) {
    ASSERT_TRUE(actor->WaitForText("joined run", kPatience)) << actor->Err();
  }
  StartServer();
  EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
  EXPECT_EQ(odd->Wait(kPatience), 0) << odd->Err();
  EXPECT_EQ(plain->Wait(kPatience), 0) << plain->Err();
  EXPECT_TRUE(Weights("pinned") == Weights("alone"));
  // So is a run resumed without the flag.
  const Ended resumed = Run("craftfleet train", {"--logdir=" + Logdir("alone"), "--resume", "--steps=256"});
  EXPECT_EQ(resumed.exit_code, 0) << resumed.err;
  const Ended refused = Run("craftfleet train", {"--logdir=" + Logdir("alone"), "--resume", "--cpu=native"});
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err, HasSubstr("cpu"));
}

// Before, with other textures than the built-in ones, the first server's game became the run's.
TEST_F(MixedBuildsTest, WithOtherTexturesTheLearnerKnowsTheGameItself) {
  const std::string textures = OtherTextures();
  StartLearner("own", {"--textures=" + textures});
  const auto learner = v1::LearnerService::NewStub(grpc::CreateChannel(address_, grpc::InsecureChannelCredentials()));
  v1::Announcement first;
  first.set_protocol_version(wire::kProtocolVersion);
  first.set_name("first");
  first.set_address("127.0.0.1:1");
  first.set_texture_digest(TextureDigest(textures).value());
  first.set_canary("0123456789abcdef");
  grpc::ClientContext context;
  v1::AnnounceReply reply;
  const grpc::Status refused = learner->Announce(&context, first, &reply);
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_THAT(refused.error_message(), HasSubstr("environment server first (build older than this one) plays another"));

  server_ = Start("craftfleet-envserver", {"--listen=127.0.0.1:0", "--learner=" + address_, "--textures=" + textures});
  const auto actor = Start("craftfleet-actor", ActorFlags());
  EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
  EXPECT_EQ(actor->Wait(kPatience), 0) << actor->Err();
}

// With port 0 the actor listens on another port after its restart. The learner has only the new address, and nothing
// listens on the old one.
TEST_F(MixedBuildsTest, AnActorThatRestartsToBePinnedIsListedUnderItsNewAddress) {
  StartFleet("ports", {"--cpu=avx2", "--steps=64000"});
  std::vector<std::string> flags = ActorFlags();
  flags.push_back("--listen=127.0.0.1:0");
  const auto actor = Start("craftfleet-actor", flags);
  const std::string old_address = actor->WaitForAddress("status on ", kPatience).value();
  ASSERT_TRUE(actor->WaitForText("joined run", kPatience)) << actor->Err();
  const auto status = AskStatus(address_);
  ASSERT_THAT(status, IsOk());
  std::vector<v1::Peer> actors;
  for (const v1::Peer& peer : status->peers()) {
    if (peer.role() == "actor") actors.push_back(peer);
  }
  ASSERT_THAT(actors, SizeIs(1));
  const auto answer = AskStatus(actors[0].address());
  ASSERT_THAT(answer, IsOk());
  EXPECT_EQ(answer->name(), actors[0].name());
  if (actors[0].address() != old_address) {
    EXPECT_THAT(AskStatus(old_address), StatusIs(absl::StatusCode::kUnavailable, HasSubstr(old_address)));
  }
}

}  // namespace
}  // namespace craftfleet
