// A learner with updates that fail, and with invalid snapshots. The learner runs in this process; the
// tests act as its actors.
#include "learner/training/trainer.h"

#include <atomic>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/time.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/canary.h"
#include "common/base/keyed_random.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "common/io/paths.h"
#include "common/io/snapshot_envelope.h"
#include "common/process/version.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "craftfleet/v1/admin.grpc.pb.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "learner/learner.h"
#include "learner/run/checkpoint.h"
#include "learner/run/checkpoint_store.h"
#include "tests/agent/stand_in_device.h"
#include "tests/fakes/metric_of.h"
#include "tests/fakes/no_tensor_memory.h"
#include "tests/fakes/play_once.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace trainer_test {

using testing::AllOf;
using testing::HasSubstr;

constexpr int kLanes = 2;
constexpr int kSteps = 8;      // of a fragment
constexpr int kFragments = 2;  // of a lane, in an iteration
constexpr int kFrameSize = 36;
constexpr int kFrameBytes = kFrameSize * kFrameSize * 3;
constexpr int kPerIteration = kLanes * kFragments;

struct Variant {
  bool resume = false;
  int overlap = 0;
  int max_staleness = 0;
  int epochs = 1;
  int iterations = 1000;
  bool evaluates = false;  // after each iteration, and at the end
  bool on_gpu = false;     // updates on the stand-in for one
};

v1::RunConfig Config(const Variant& variant) {
  v1::RunConfig config = DefaultRunConfig();
  config.mutable_network()->set_frame_size(kFrameSize);
  config.set_steps(variant.iterations * kPerIteration * kSteps);
  config.set_lanes(kLanes);
  config.set_tile(kLanes);
  config.set_fragment_steps(kSteps);
  config.set_gradient_shards(2);
  config.mutable_ppo()->set_rollout_steps(kPerIteration * kSteps);
  config.mutable_ppo()->set_minibatch_size(16);
  config.mutable_ppo()->set_epochs(variant.epochs);
  config.mutable_eval()->set_every_steps(variant.evaluates ? kPerIteration * kSteps : 0);
  config.mutable_eval()->set_episodes(1);
  config.mutable_eval()->set_final_episodes(variant.evaluates ? 1 : 0);
  config.mutable_checkpoint()->set_every_iterations(100);
  config.set_overlap(variant.overlap);
  config.set_max_staleness(variant.max_staleness);
  if (variant.on_gpu) config.set_device(v1::RunConfig::CUDA_UPDATES);
  return config;
}

// A valid fragment, the same from every sender.
Fragment PlayedFragment(int lane, int64_t number, int64_t version, int64_t epoch) {
  Fragment fragment;
  fragment.epoch = epoch;
  fragment.lane = lane;
  fragment.number = number;
  fragment.policy_version = version;
  auto draw = [&, n = uint64_t{0}]() mutable {
    return KeyedBits(RandomUse::kInitialWeights, 7, static_cast<uint64_t>(number * kLanes + lane), n++);
  };
  for (int i = 0; i < kSteps * kFrameBytes; ++i) fragment.frames.push_back(static_cast<char>(draw()));
  for (int t = 0; t < kSteps; ++t) {
    fragment.actions.push_back(static_cast<char>(draw() % kNumActions));
    fragment.log_probs.push_back(-2.8F);
    fragment.values.push_back(static_cast<float>(draw() % 100) / 100);
    fragment.rewards.push_back(draw() % 4 == 0 ? 1.0F : 0.0F);
    fragment.ends.push_back(StepEnd::kNone);
  }
  fragment.snapshot.game = SealSnapshot(EnvDigest("crafter", kEpisodeLength), absl::StrCat("after ", number));
  return fragment;
}

// Every value is within its range, but an update that learned from it would be another.
void Poison(Fragment* fragment) {
  for (float& log_prob : fragment->log_probs) log_prob = wire::kMinLogProb;
}

// A learner that trains in its own thread.
class Training {
 public:
  Training(const std::string& logdir, const Variant& variant) {
    Learner::Options options;
    options.config = Config(variant);
    options.logdir = logdir;
    options.resume = variant.resume;
    options.texture_dir = DefaultTextureDir().value();
    if (variant.on_gpu) options.device = kStandInDevice;
    learner_ = Learner::Create(options).value();
    stub_ = v1::LearnerService::NewStub(learner_->InProcess().channel);
    thread_ = std::thread([this] { status_ = learner_->Run(); });
  }
  ~Training() {
    if (thread_.joinable()) Stop().IgnoreError();
  }
  // Waits for the end; returns the status of Run.
  absl::Status Wait() {
    thread_.join();
    return status_;
  }
  void RequestStop() { learner_->Stop(); }
  absl::Status Stop() {
    RequestStop();
    return Wait();
  }

  void Join(const std::string& actor) {
    v1::JoinRequest request;
    request.set_protocol_version(wire::kProtocolVersion);
    request.set_actor(actor);
    request.set_build(BuildId());
    request.set_canary(*PolicyCanary());
    v1::JoinReply reply;
    grpc::ClientContext context;
    ASSERT_TRUE(stub_->Join(&context, request, &reply).ok());
    epoch_ = reply.epoch();
  }
  // Requests permits for `actor`, which has none.
  std::vector<v1::Permit> Ask(const std::string& actor, const std::vector<v1::LaneFailure>& failures = {},
                              int capacity = kLanes) {
    v1::PermitRequest request;
    request.set_actor(actor);
    request.set_epoch(epoch_);
    request.set_capacity(capacity);
    request.set_wait_ms(2000);
    for (const v1::LaneFailure& failure : failures) *request.add_failures() = failure;
    const auto reply = AskOnce(stub_.get(), request);
    if (!reply.ok()) return {};
    return {reply->granted().begin(), reply->granted().end()};
  }
  v1::FragmentVerdict::Verdict Push(const std::string& actor, const Fragment& fragment) {
    v1::FragmentMessage message = wire::ToProto(fragment);
    message.set_actor(actor);
    return PushOnce(stub_.get(), std::move(message)).value_or(v1::FragmentVerdict()).verdict();
  }
  void Leave(const std::string& actor) {
    v1::LeaveRequest request;
    request.set_actor(actor);
    v1::LeaveReply reply;
    grpc::ClientContext context;
    ASSERT_TRUE(stub_->Leave(&context, request, &reply).ok());
  }
  // Joins, sends `fragments` accepted fragments, each modified by `change`, and leaves.
  void Play(
      const std::string& actor, int fragments, const std::function<void(Fragment*)>& change = [](Fragment*) {}) {
    Join(actor);
    for (int tries = 0; fragments > 0 && tries < 300; ++tries) {
      for (const v1::Permit& permit : Ask(actor)) {
        Fragment fragment = PlayedFragment(permit.lane(), permit.fragment(), permit.policy_version(), epoch_);
        change(&fragment);
        ASSERT_EQ(Push(actor, fragment), v1::FragmentVerdict::ACCEPTED);
        if (--fragments == 0) break;
      }
    }
    ASSERT_EQ(fragments, 0) << "no permits for the rest";
    Leave(actor);
  }
  // Plays an iteration of poisoned fragments, whose update fails.
  void PlayInVain(const std::string& actor) {
    const NoTensorMemory no_memory;
    Play(actor, kPerIteration, Poison);
    ASSERT_TRUE(WaitUntil([this] { return Metric("updates_undone") > 0; }));
  }
  Fragment Played(const v1::Permit& permit) const {
    return PlayedFragment(permit.lane(), permit.fragment(), permit.policy_version(), epoch_);
  }
  // The only actor can't restore any lane, and reports that twice.
  void RefuseAll(const std::string& actor) {
    Join(actor);
    std::vector<v1::LaneFailure> failures;
    for (int i = 0; i < 3; ++i) {
      std::vector<v1::Permit> permits = Ask(actor, failures);
      failures.clear();
      if (i == 2) break;
      ASSERT_EQ(permits.size(), kLanes);
      for (const v1::Permit& permit : permits) {
        failures.emplace_back().set_lane(permit.lane());
        failures.back().set_fragment(permit.fragment());
        failures.back().set_reason("snapshot: not a world's");
      }
    }
    Leave(actor);
  }
  // As craftfleet admin checkpoint.
  absl::StatusOr<int64_t> RequestCheckpoint() {
    const auto stub = v1::AdminService::NewStub(learner_->InProcess().channel);
    grpc::ClientContext context;
    wire::SetDeadline(&context, absl::Seconds(20));
    v1::CheckpointReply reply;
    const grpc::Status status = stub->Checkpoint(&context, v1::CheckpointRequest(), &reply);
    if (!status.ok()) return wire::FromGrpc(status, "checkpoint");
    return reply.iteration();
  }
  // Plays evaluations until the run is over.
  void PlayEvaluations(const std::string& actor) {
    Join(actor);
    v1::PermitRequest request;
    request.set_actor(actor);
    request.set_epoch(epoch_);
    request.set_wait_ms(10);
    request.set_evaluates(true);
    for (int tries = 0; tries < 1000; ++tries) {
      const auto reply = AskOnce(stub_.get(), request);
      ASSERT_THAT(reply, IsOk());
      if (reply->finished()) return Leave(actor);
      if (!reply->has_evaluation()) continue;
      Episode episode;
      episode.length = kSteps;
      v1::EvaluationResult result = wire::ToProto(std::vector<Episode>(reply->evaluation().episodes(), episode));
      result.set_actor(actor);
      result.set_epoch(epoch_);
      result.set_id(reply->evaluation().id());
      v1::EvaluationReply finished;
      grpc::ClientContext context;
      ASSERT_TRUE(stub_->FinishEvaluation(&context, result, &finished).ok());
    }
    FAIL() << "the run goes on";
  }
  // Waits for the weights of `version`; empty after a minute.
  std::string Weights(int64_t version) {
    v1::WeightsRequest request;
    request.set_at_least(version);
    std::string weights;
    const auto download = [&] {
      grpc::ClientContext context;
      const auto stream = stub_->GetWeights(&context, request);
      weights.clear();
      v1::WeightsChunk chunk;
      while (stream->Read(&chunk)) weights += chunk.data();
      return stream->Finish().ok();
    };
    return WaitUntil(download, absl::Minutes(1)) ? weights : "";
  }
  double Metric(const std::string& name) {
    v1::StatusReply reply;
    learner_->trainer().FillStatus(&reply);
    return MetricOf(reply, name);
  }

 private:
  std::unique_ptr<Learner> learner_;
  std::unique_ptr<v1::LearnerService::Stub> stub_;
  int64_t epoch_ = 0;
  absl::Status status_;
  std::thread thread_;
};

class TrainerTest : public testing::Test {
 protected:
  std::unique_ptr<Training> Begin(const std::string& run, const Variant& variant = {}) {
    return std::make_unique<Training>(folder_ / run, variant);
  }
  // The weights after two iterations without faults.
  std::string QuietWeights() {
    const auto quiet = Begin("quiet");
    quiet->Play("a", 2 * kPerIteration);
    return quiet->Weights(2);
  }

  const TempFolder folder_;
};

TEST_F(TrainerTest, AnUpdateThatFailsIsUndoneAndItsIterationPlayedAgain) {
  const std::string quiet = QuietWeights();
  ASSERT_FALSE(quiet.empty());
  const auto training = Begin("disturbed");
  training->Play("a", kPerIteration);
  ASSERT_FALSE(training->Weights(1).empty());
  testing::internal::CaptureStderr();
  training->PlayInVain("liar");
  training->Play("a", kPerIteration);
  EXPECT_TRUE(training->Weights(2) == quiet) << "to the bit";
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("the update of iteration 2 failed"), HasSubstr("its fragments will be played again"),
                    HasSubstr("from liar: 4 fragments; log_probs down to -104")));
  EXPECT_EQ(training->Metric("updates_undone"), 1);
}

TEST_F(TrainerTest, TheSecondFailureInARowEndsTheLearnerAndItResumes) {
  const std::string quiet = QuietWeights();
  {
    const auto training = Begin("ended");
    training->Play("a", kPerIteration);
    ASSERT_FALSE(training->Weights(1).empty());
    const NoTensorMemory no_memory;
    for (int i = 0; i < 2; ++i) training->Play("liar", kPerIteration, Poison);
    EXPECT_THAT(training->Wait(), StatusIs(absl::StatusCode::kInternal, HasSubstr("bad_alloc")));
  }
  const auto training = Begin("ended", {/*resume=*/true});
  EXPECT_EQ(training->Metric("iteration"), 1) << "although the next checkpoint was only due after 100";
  training->Play("a", kPerIteration);
  EXPECT_TRUE(training->Weights(2) == quiet);
}

// Its weights are lost, so that nothing could be learned from fragments that are played again.
TEST_F(TrainerTest, AGpuThatFailsEndsTheRunAtOnce) {
  Variant variant;
  variant.on_gpu = true;
  auto training = Begin("gpu", variant);
  training->Play("a", kPerIteration);
  ASSERT_FALSE(training->Weights(1).empty());
  testing::internal::CaptureStderr();
  ObserveComputations([](auto&&...) { throw std::runtime_error("CUDA error: an illegal memory access"); });
  training->Play("a", kPerIteration);
  const absl::Status status = training->Wait();
  ObserveComputations(nullptr);
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnavailable, HasSubstr("start again with --resume")));
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, AllOf(HasSubstr("the update of iteration 2 failed"), HasSubstr("; training ends"),
                         HasSubstr("undoing an update: the GPU or its driver failed")));
  EXPECT_THAT(log, testing::Not(HasSubstr("played again")));
  training.reset();
  variant.resume = true;
  EXPECT_EQ(Begin("gpu", variant)->Metric("iteration"), 0) << "the last checkpoint";
}

// The stop comes too late to undo the update: a checkpoint with its weights and without its iteration would let the
// resumed run learn the same rollout twice.
TEST_F(TrainerTest, AStopAtTheEndOfAnUpdateKeepsItsIteration) {
  Variant variant;
  variant.on_gpu = true;
  const auto training = Begin("gpu", variant);
  std::atomic<int> computations = 0;
  ObserveComputations([&](auto&&...) { ++computations; });
  for (int64_t version = 1; version <= 2; ++version) {
    computations = 0;
    training->Play("a", kPerIteration);
    ASSERT_FALSE(training->Weights(version).empty());
  }
  ObserveComputations([&](auto&&...) {
    if (--computations == 0) training->RequestStop();
  });
  training->Play("a", kPerIteration);
  ASSERT_THAT(training->Wait(), IsOk());
  ObserveComputations(nullptr);
  const v1::CheckpointState state = LoadCheckpointState(folder_ / "gpu/checkpoints/" + CheckpointName(3)).value();
  EXPECT_EQ(state.optimizer_steps(), 3 * kPerIteration * kSteps / 16) << "minibatches of 16";
}

TEST_F(TrainerTest, ALaneResetWithinAnIterationDoesNotChangeTheResult) {
  const std::string quiet = QuietWeights();
  const auto training = Begin("put-back");
  training->Play("a", kPerIteration);
  // The first fragment of each lane has a snapshot with a valid envelope but invalid content.
  training->Play("liar", kLanes, [](Fragment* fragment) {
    fragment->values[0] = 0.5F;
    fragment->snapshot.game = SealSnapshot(EnvDigest("crafter", kEpisodeLength), "no game");
  });
  training->RefuseAll("a");
  training->Play("a", kPerIteration);
  EXPECT_TRUE(training->Weights(2) == quiet);
}

TEST_F(TrainerTest, OverlappedIterationsArePlayedWithTheWeightsFromBeforeTheUpdate) {
  const auto training = Begin("overlapped", {/*resume=*/false, /*overlap=*/1});
  std::vector<int64_t> versions;
  training->Play("a", 4 * kPerIteration, [&](Fragment* f) { versions.push_back(f->policy_version); });
  std::vector<int64_t> wanted;
  for (const int64_t version : {0, 0, 1, 2}) wanted.insert(wanted.end(), kPerIteration, version);
  EXPECT_EQ(versions, wanted);
}

TEST_F(TrainerTest, AnOverlappedUpdateThatFailsIsUndoneWithTheFragmentsPlayedMeanwhile) {
  const Variant overlapped = {/*resume=*/false, /*overlap=*/1};
  const auto quiet = Begin("quiet-overlapped", overlapped);
  quiet->Play("a", 3 * kPerIteration);
  const auto training = Begin("disturbed-overlapped", overlapped);
  training->Play("a", kPerIteration);
  ASSERT_FALSE(training->Weights(1).empty());
  training->PlayInVain("liar");
  std::vector<int64_t> versions;
  training->Play("a", 2 * kPerIteration, [&](Fragment* f) { versions.push_back(f->policy_version); });
  EXPECT_EQ(versions, (std::vector<int64_t>{0, 0, 0, 0, 1, 1, 1, 1}));
  EXPECT_TRUE(training->Weights(3) == quiet->Weights(3));
}

// With one epoch and with two, which correct the lag.
TEST_F(TrainerTest, AnOverlappedRunResumesWithTheWeightsThatItPlayedWith) {
  for (const int epochs : {1, 2}) {
    SCOPED_TRACE(epochs);
    const auto begin = [&](const std::string& run, bool resume, int overlap = 1) {
      return Begin(absl::StrCat(run, epochs), {resume, overlap, /*max_staleness=*/0, epochs});
    };
    const auto quiet = begin("quiet", false);
    quiet->Play("a", 3 * kPerIteration);
    {
      const auto training = begin("stopped", false);
      training->Play("a", 2 * kPerIteration);
      ASSERT_FALSE(training->Weights(2).empty());
      ASSERT_THAT(training->Stop(), IsOk());
    }
    const auto training = begin("stopped", true);
    std::vector<int64_t> versions;
    training->Play("a", kPerIteration, [&](Fragment* f) { versions.push_back(f->policy_version); });
    EXPECT_EQ(versions, (std::vector<int64_t>(kPerIteration, 1)));
    EXPECT_TRUE(training->Weights(3) == quiet->Weights(3));
    if (epochs == 1) continue;  // there is nothing to correct
    const auto synchronous = begin("synchronous", false, /*overlap=*/0);
    synchronous->Play("a", 3 * kPerIteration);
    EXPECT_FALSE(synchronous->Weights(3) == quiet->Weights(3));
  }
}

// The request timed out. One served a moment later left the run without its final evaluation: the same command with
// --autoresume removed the result.
TEST_F(TrainerTest, ARequestedCheckpointIsWrittenWhileTrainingWaitsForEvaluationsAndAgainAtTheEnd) {
  Variant evaluated;
  evaluated.iterations = 3;
  evaluated.evaluates = true;
  const auto training = Begin("evaluated", evaluated);
  training->Play("a", 3 * kPerIteration);
  ASSERT_TRUE(WaitUntil([&] { return training->Metric("iteration") >= 3; }));
  EXPECT_EQ(training->RequestCheckpoint().value(), 3);
  const std::string path = folder_ / "evaluated/checkpoints/" + CheckpointName(3);
  EXPECT_EQ(LoadCheckpointState(path).value().pending_size(), 3) << "two are too few to wait for";
  training->PlayEvaluations("a");
  ASSERT_THAT(training->Wait(), IsOk());
  const v1::CheckpointState state = LoadCheckpointState(path).value();
  EXPECT_EQ(state.pending_size(), 0);
  EXPECT_EQ(state.final_evaluation_steps(), 3 * kPerIteration * kSteps);
}

const Variant kAsynchronous = {/*resume=*/false, /*overlap=*/0, /*max_staleness=*/1};

class AsynchronousTrainerTest : public TrainerTest {
 protected:
  std::unique_ptr<Training> Resume(const std::string& run) {
    Variant variant = kAsynchronous;
    variant.resume = true;
    return Begin(run, variant);
  }
};

TEST_F(AsynchronousTrainerTest, AnUpdateLearnsFromWhatArrivesFirst) {
  const auto training = Begin("async", kAsynchronous);
  training->Join("slow");
  const std::vector<v1::Permit> slow = training->Ask("slow", {}, /*capacity=*/1);
  ASSERT_EQ(slow.size(), 1U);
  training->Play("fast", kPerIteration);
  ASSERT_FALSE(training->Weights(1).empty());
  EXPECT_EQ(training->Push("slow", training->Played(slow[0])), v1::FragmentVerdict::ACCEPTED) << "one update old";
  training->Play("fast", kPerIteration - 1);
  ASSERT_FALSE(training->Weights(2).empty());
  while (training->Metric("iteration") < 2) training->Join("slow");
  EXPECT_EQ(training->Metric("staleness_max"), 1);
  ASSERT_THAT(training->Stop(), IsOk());
}

TEST_F(AsynchronousTrainerTest, AFragmentThatIsTooOldIsRefused) {
  const auto training = Begin("async", kAsynchronous);
  training->Join("slow");
  const std::vector<v1::Permit> slow = training->Ask("slow", {}, /*capacity=*/1);
  ASSERT_EQ(slow.size(), 1U);
  training->Play("fast", 2 * kPerIteration);
  ASSERT_FALSE(training->Weights(2).empty());
  EXPECT_EQ(training->Push("slow", training->Played(slow[0])), v1::FragmentVerdict::EXPIRED);
  training->Play("fast", kPerIteration);
  EXPECT_FALSE(training->Weights(3).empty());
}

TEST_F(AsynchronousTrainerTest, AStoppedRunGoesOnFromItsCheckpoint) {
  {
    const auto training = Begin("stopped", kAsynchronous);
    training->Play("a", 2 * kPerIteration + 1);  // one is not learned from
    ASSERT_FALSE(training->Weights(2).empty());
    ASSERT_THAT(training->Stop(), IsOk());
  }
  const auto training = Resume("stopped");
  std::vector<int64_t> versions;
  training->Play("a", kPerIteration, [&](Fragment* f) { versions.push_back(f->policy_version); });
  EXPECT_EQ(versions, (std::vector<int64_t>(kPerIteration, 2)));
  EXPECT_FALSE(training->Weights(3).empty());
}

TEST_F(AsynchronousTrainerTest, AnUpdateThatFailsIsUndone) {
  const auto training = Begin("disturbed", kAsynchronous);
  training->PlayInVain("liar");
  training->Play("a", 2 * kPerIteration);
  EXPECT_FALSE(training->Weights(2).empty());
  EXPECT_EQ(training->Metric("updates_undone"), 1);
}

}  // namespace trainer_test
}  // namespace craftfleet
