#include "actor/evaluation_worker.h"

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/mutex.h"
#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

constexpr char kNobody[] = "127.0.0.1:1";  // where no learner listens
constexpr int64_t kEpoch = 3;
constexpr int64_t kTask = 43;

// What a worker logs about a task whose weights it gets from `weights` or requests from `learner`.
std::string LogOfATask(const LearnerClient& learner, std::optional<LocalWeights> weights = std::nullopt,
                       const std::vector<wire::Endpoint>& slow_servers = {}) {
  EvaluationWorker::Options options;
  options.spec = *FindAgent("ppo_cnn");
  options.weights = std::move(weights);
  options.env_servers = std::make_shared<EnvDirectory>(slow_servers);
  options.health = std::make_shared<ServerHealth>(ServerHealth::Options());
  for (const wire::Endpoint& server : slow_servers) options.health->NoteStep(server, absl::Seconds(4));
  EvaluationWorker worker(options, &learner);
  v1::EvaluationTask task;
  task.set_id(kTask);
  testing::internal::CaptureStderr();
  worker.Assign(kEpoch, task);
  EXPECT_TRUE(WaitUntil([&worker] { return worker.current(kEpoch) == 0; })) << "the task is over";
  worker.Stop();
  return testing::internal::GetCapturedStderr();
}

TEST(EvaluationWorker, ATaskThatCannotBePlayedIsReported) {
  const LearnerClient learner(wire::Connect(kNobody));
  EXPECT_THAT(LogOfATask(learner), HasSubstr("evaluation task 43 returned: learner 127.0.0.1:1"));
}

TEST(EvaluationWorker, TakesLocalWeightsInsteadOfCallingTheLearner) {
  const LearnerClient learner(wire::Connect(kNobody));
  int64_t asked = 0;
  auto weights = std::make_shared<const HostWeights>(SampleWeights(1));
  const auto find = [&](int64_t id) {
    asked = id;
    return weights;
  };
  EXPECT_THAT(LogOfATask(learner, LocalWeights{nullptr, find}), HasSubstr("no environment server is known yet"));
  EXPECT_EQ(asked, kTask);
  weights = nullptr;
  EXPECT_THAT(LogOfATask(learner, LocalWeights{nullptr, find}), HasSubstr("evaluation task 43 returned: it is over"));
}

// A run with only that server would not end otherwise.
TEST(EvaluationWorker, UsesASlowServerIfThereIsNoOther) {
  const LearnerClient learner(wire::Connect(kNobody));
  const auto find = [weights = std::make_shared<const HostWeights>(SampleWeights(1))](int64_t) { return weights; };
  EXPECT_THAT(LogOfATask(learner, LocalWeights{nullptr, find}, {{kNobody, nullptr}}),
              HasSubstr("evaluation task 43 returned: environment server 127.0.0.1:1: cannot connect"));
}

// Complete runs used to end with this warning if the reply to their last result came too late.
TEST(EvaluationWorker, ATaskThatEndsWithItsActorIsNot) {
  LearnerClient learner(wire::Connect(kNobody));
  learner.Cancel();
  EXPECT_THAT(LogOfATask(learner), Not(HasSubstr("43")));
}

// A learner that refuses the first results with given codes. Thread-safe.
class ResultService final : public v1::LearnerService::Service {
 public:
  void Refuse(const std::vector<grpc::StatusCode>& codes) {
    const MutexLock lock(&mu_);
    codes_ = codes;
  }
  std::vector<v1::EvaluationResult> received() const {
    const MutexLock lock(&mu_);
    return received_;
  }
  grpc::Status FinishEvaluation(grpc::ServerContext* /*context*/, const v1::EvaluationResult* result,
                                v1::EvaluationReply* /*reply*/) override {
    const MutexLock lock(&mu_);
    received_.push_back(*result);
    if (received_.size() > codes_.size()) return grpc::Status::OK;
    return {codes_[received_.size() - 1], "not now"};
  }

 private:
  mutable Mutex mu_;
  std::vector<grpc::StatusCode> codes_ ABSL_GUARDED_BY(mu_);
  std::vector<v1::EvaluationResult> received_ ABSL_GUARDED_BY(mu_);
};

// A worker that can play, and the learner that gets its results.
class EvaluationWorkerTest : public testing::Test {
 protected:
  static constexpr int kLength = 5;  // of an episode
  static constexpr int kFrameBytes = 64 * 64 * 3;

  EvaluationWorkerTest() {
    EvaluationWorker::Options options;
    options.actor = "a";
    options.spec = *FindAgent("ppo_cnn");
    options.hello = SampleHello(kLength);
    const auto find = [weights = std::make_shared<const HostWeights>(SampleWeights(1))](int64_t) { return weights; };
    options.weights = LocalWeights{nullptr, find};
    const wire::Endpoint server = env_.Connect();
    options.env_servers = std::make_shared<EnvDirectory>(std::vector<wire::Endpoint>{server});
    options.health = std::make_shared<ServerHealth>(ServerHealth::Options{SampleHello(kLength), kFrameBytes});
    EXPECT_TRUE(WaitUntil([&] { return options.health->MayUse(server); }));
    worker_ = std::make_unique<EvaluationWorker>(options, &learner_);
  }
  static v1::EvaluationTask Task(int episodes) {
    v1::EvaluationTask task;
    task.set_id(kTask);
    *task.mutable_env() = SampleHello(kLength).env();
    task.set_first_episode(1);
    task.set_episodes(episodes);
    return task;
  }
  // Plays one episode, and waits until the worker is done with it.
  void PlayOne() {
    worker_->Assign(kEpoch, Task(1));
    EXPECT_TRUE(WaitUntil([this] { return worker_->current(kEpoch) == 0; }));
  }

  EnvServer env_;
  ResultService service_;
  const std::unique_ptr<wire::Server> server_ = *wire::Server::Create({"127.0.0.1:0"}, {&service_});
  const LearnerClient learner_{wire::Connect(server_->address())};
  std::unique_ptr<EvaluationWorker> worker_;
};

// It used to be played again, for minutes or hours, if the learner could not be reached for four seconds.
TEST_F(EvaluationWorkerTest, AResultIsSentUntilTheLearnerTakesIt) {
  // The last one: it does not know this actor, which will join again.
  service_.Refuse({grpc::StatusCode::UNAVAILABLE, grpc::StatusCode::DEADLINE_EXCEEDED, grpc::StatusCode::ABORTED});
  PlayOne();
  const std::vector<v1::EvaluationResult> received = service_.received();
  ASSERT_EQ(received.size(), 4U);
  EXPECT_EQ(received[3].actor(), "a");
  EXPECT_EQ(received[3].epoch(), kEpoch);
  EXPECT_EQ(received[3].id(), kTask);
  EXPECT_EQ(received[3].episodes_size(), 1);
}

TEST_F(EvaluationWorkerTest, ARefusedResultIsReportedAndDropped) {
  service_.Refuse({grpc::StatusCode::FAILED_PRECONDITION});
  testing::internal::CaptureStderr();
  PlayOne();
  worker_->Stop();
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("evaluation task 43 returned"));
  EXPECT_EQ(service_.received().size(), 1U);
}

TEST_F(EvaluationWorkerTest, StopsWhileTheLearnerTakesNoResult) {
  service_.Refuse(std::vector<grpc::StatusCode>(1000, grpc::StatusCode::UNAVAILABLE));
  worker_->Assign(kEpoch, Task(1));
  EXPECT_TRUE(WaitUntil([this] { return service_.received().size() > 1; }));
  worker_->Stop();
  EXPECT_LT(service_.received().size(), 10U);
}

// It kept the next start's tasks waiting, although its result could only be refused.
TEST_F(EvaluationWorkerTest, ATaskOfAFormerStartOfTheLearnerIsDropped) {
  worker_->Assign(kEpoch, Task(10'000));
  EXPECT_TRUE(WaitUntil([this] {
    v1::StatusReply status;
    env_.service->FillStatus(&status);
    return status.peers_size() > 0;
  }));
  worker_->KeepOnly(kEpoch);
  EXPECT_EQ(worker_->current(kEpoch), kTask);
  testing::internal::CaptureStderr();
  worker_->KeepOnly(kEpoch + 1);
  EXPECT_TRUE(WaitUntil([this] { return worker_->current(kEpoch) == 0; }, absl::Seconds(10)));
  EXPECT_TRUE(worker_->ready());
  worker_->Assign(kEpoch + 1, Task(1));
  EXPECT_TRUE(WaitUntil([this] { return worker_->current(kEpoch + 1) == 0; }));
  EXPECT_THAT(testing::internal::GetCapturedStderr(), Not(HasSubstr("returned")));
  ASSERT_EQ(service_.received().size(), 1U);
  EXPECT_EQ(service_.received()[0].epoch(), kEpoch + 1);
}

}  // namespace
}  // namespace craftfleet
