#include "actor/evaluation_worker.h"

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr char kNobody[] = "127.0.0.1:1";  // where no learner listens
constexpr int64_t kEpoch = 3;
constexpr int64_t kTask = 43;

// What a worker logs about a task whose weights it requests from `learner`.
std::string LogOfATask(const LearnerClient& learner) {
  EvaluationWorker::Options options;
  options.env_servers = std::make_shared<EnvDirectory>(std::vector<wire::Endpoint>());
  options.health = std::make_shared<ServerHealth>(ServerHealth::Options());
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

// Complete runs used to end with this warning if the reply to their last result came too late.
TEST(EvaluationWorker, ATaskThatEndsWithItsActorIsNot) {
  LearnerClient learner(wire::Connect(kNobody));
  learner.Cancel();
  EXPECT_THAT(LogOfATask(learner), Not(HasSubstr("43")));
}

}  // namespace
}  // namespace craftfleet
