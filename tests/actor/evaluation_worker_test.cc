#include "actor/evaluation_worker.h"

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
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
  auto weights = std::make_shared<const std::string>(SampleWeights(1));
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
  const auto find = [weights = std::make_shared<const std::string>(SampleWeights(1))](int64_t) { return weights; };
  EXPECT_THAT(LogOfATask(learner, LocalWeights{nullptr, find}, {{kNobody, nullptr}}),
              HasSubstr("evaluation task 43 returned: environment server 127.0.0.1:1: cannot connect"));
}

// Complete runs used to end with this warning if the reply to their last result came too late.
TEST(EvaluationWorker, ATaskThatEndsWithItsActorIsNot) {
  LearnerClient learner(wire::Connect(kNobody));
  learner.Cancel();
  EXPECT_THAT(LogOfATask(learner), Not(HasSubstr("43")));
}

}  // namespace
}  // namespace craftfleet
