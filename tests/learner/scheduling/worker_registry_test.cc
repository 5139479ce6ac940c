// The registry has one record of each worker, so that every call sees the changes of all earlier ones.
#include "learner/scheduling/worker_registry.h"

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

using testing::IsEmpty;
using testing::SizeIs;

Evaluation SampleEvaluation(int64_t number) {
  return {number, number * 1000, 1, 1, false, std::make_shared<HostWeights>("weights")};
}

WorkerRegistry::PermitRequest Question(const std::string& actor, int64_t evaluation = 0) {
  WorkerRegistry::PermitRequest request = TestRegistry::RequestOf(actor, {}, 4);
  request.evaluates = true;
  request.evaluation = evaluation;
  return request;
}

class WorkerRegistryTest : public testing::Test {
 protected:
  WorkerRegistry& registry() { return registry_; }
  WorkerRegistry::PermitReply Ask(const WorkerRegistry::PermitRequest& request) {
    const auto reply = registry_.GetPermits(request);
    EXPECT_THAT(reply, IsOk());
    return reply.value_or(WorkerRegistry::PermitReply());
  }

  FakeClock clock_;
  TestRegistry registry_{{4}, std::vector<LaneRecord>(4), &clock_};
};

// With separate locks for permits and evaluations, "a" got a task in this history: GetPermits(a) got its permits,
// Drain(a) reported "a is drained", and GetPermits(a) then returned an evaluation. Another thread drains "a" while
// is_cancelled runs, which is called between the two halves of GetPermits.
TEST_F(WorkerRegistryTest, ADrainedActorIsNotAssignedAnEvaluation) {
  registry_.Join("a", "");
  registry_.AddEvaluation(SampleEvaluation(1));
  std::atomic<bool> asked{false};
  std::thread admin;
  WorkerRegistry::PermitRequest request = Question("a");
  request.is_cancelled = [&] {
    admin = std::thread([&] {
      asked = true;
      registry_.Drain("a");
    });
    while (!asked) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return false;
  };
  const WorkerRegistry::PermitReply reply = Ask(request);
  admin.join();
  // The call came first and got a task, so the drained actor is not done.
  ASSERT_TRUE(reply.evaluation.has_value());
  EXPECT_FALSE(registry_.IsDrained("a"));
  const WorkerRegistry::PermitReply playing = Ask(Question("a", reply.evaluation->id));
  EXPECT_FALSE(playing.evaluation.has_value());
  EXPECT_THAT(registry_.FinishEvaluation("a", reply.evaluation->id, std::vector<Episode>(1)), IsOk());
  EXPECT_FALSE(Ask(Question("a")).evaluation.has_value()) << "the other task is for other actors";
  EXPECT_TRUE(registry_.IsDrained("a"));
}

// Actors expire when one calls, and here there is no other.
TEST_F(WorkerRegistryTest, AnActorThatIsKilledWhileItIsDrainedIsGoneOnceItCannotRenewItsLease) {
  registry_.Join("a", "");
  registry_.OpenIteration(2, 1);
  registry_.AddEvaluation(SampleEvaluation(1));
  const WorkerRegistry::PermitReply reply = Ask(Question("a"));
  ASSERT_THAT(reply.granted, SizeIs(4));
  ASSERT_TRUE(reply.evaluation.has_value());
  registry_.Drain("a");
  clock_.Advance(absl::Seconds(10));
  EXPECT_FALSE(registry_.IsDrained("a")) << "it may still renew its lease";
  clock_.Advance(absl::Milliseconds(1));
  EXPECT_TRUE(registry_.IsDrained("a"));
}

TEST_F(WorkerRegistryTest, UndrainWakesAnActorThatWaits) {
  registry_.Join("a", "");
  registry_.OpenIteration(2, 1);
  registry_.Drain("a");
  size_t granted = 0;
  std::thread actor([&] {
    WorkerRegistry::PermitRequest request = Question("a");
    request.wait = absl::InfiniteDuration();
    granted = Ask(request).granted.size();
  });
  EXPECT_THAT(registry_.Undrain("a"), IsOk());
  actor.join();
  EXPECT_EQ(granted, 4);
}

TEST_F(WorkerRegistryTest, ADrainedActorThatLostItsLeaseStaysDrained) {
  registry_.Join("a", "");
  registry_.OpenIteration(2, 1);
  registry_.Drain("a");
  clock_.Advance(absl::Seconds(11));
  EXPECT_THAT(registry_.GetPermits(Question("a")), StatusIs(absl::StatusCode::kAborted, testing::HasSubstr("join")));
  registry_.Join("a", "");
  EXPECT_THAT(Ask(Question("a")).granted, IsEmpty());
}

// The actor has the lane's game, which became invalid when the lane was reset.
TEST_F(WorkerRegistryTest, APermitForAResetLaneRequiresItsSnapshot) {
  TestRegistry registry({1}, {{6, {"bad", {1}}, {"before 5", {0}}}}, &clock_);
  registry.OpenIteration(8, 1);
  registry.Join("holds the game", "");
  const auto ask = [&](const std::string& actor) {
    const auto reply = registry.GetPermits(actor, {}, 1, absl::ZeroDuration());
    return reply.ok() ? reply->granted : std::vector<Permit>();
  };
  ASSERT_THAT(ask("holds the game"), SizeIs(1));
  WorkerRegistry::PermitRequest fails = TestRegistry::RequestOf("holds the game", {}, 1);
  fails.failures = {{0, 6, "no game"}};
  auto granted = registry.GetPermits(fails)->granted;
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_FALSE(granted[0].reload) << "the lane is not reset yet";
  granted = registry.GetPermits(fails)->granted;
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_EQ(granted[0].fragment, 6);
  EXPECT_TRUE(granted[0].reload);
  ASSERT_EQ(registry.Accept("holds the game", granted[0], {"before 7", {0}}).value(),
            LaneScheduler::Verdict::kAccepted);
  granted = ask("holds the game");
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_FALSE(granted[0].reload) << "its game is valid again";
  // The iteration is undone: the same fragment is played again, from the snapshot.
  registry.RewindIterations(1);
  registry.OpenIteration(8, 1);
  granted = ask("holds the game");
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_TRUE(granted[0].reload);
}

// With max_staleness it may have a game of its own at that fragment, which it played with older weights.
TEST_F(WorkerRegistryTest, AnActorTakesALaneOverFromItsSnapshot) {
  TestRegistry registry({1}, std::vector<LaneRecord>(1), &clock_);
  registry.OpenIteration(8, 1);
  const auto ask = [&](const std::string& actor) {
    const auto reply = registry.GetPermits(actor, {}, 1, absl::ZeroDuration());
    return reply.ok() ? reply->granted : std::vector<Permit>();
  };
  registry.Join("a", "");
  std::vector<Permit> granted = ask("a");
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_FALSE(granted[0].reload);
  ASSERT_EQ(registry.Accept("a", granted[0], {"before 1", {0}}).value(), LaneScheduler::Verdict::kAccepted);
  granted = ask("a");
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_FALSE(granted[0].reload) << "its own game";
  clock_.Advance(absl::Minutes(1));
  registry.Join("b", "");
  granted = ask("b");
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_EQ(granted[0].fragment, 1);
  EXPECT_TRUE(granted[0].reload);
}

TEST_F(WorkerRegistryTest, ALapsedNameHasNoStateOfItsFormerOwner) {
  EXPECT_THAT(registry().Join({"one"}, "a", "host:1", {}), IsOk());
  registry_.OpenIteration(2, 1);
  WorkerRegistry::PermitRequest request = Question("a");
  request.client.identity = "one";
  EXPECT_THAT(Ask(request).granted, SizeIs(4));
  registry_.Drain("a");
  clock_.Advance(absl::Seconds(20));
  request.client.identity = "two";
  EXPECT_THAT(registry_.GetPermits(request), StatusIs(absl::StatusCode::kAborted, testing::HasSubstr("join again")));
  EXPECT_EQ(registry_.permits(), 0);
  EXPECT_THAT(registry().Join({"two"}, "a", "host:2", {}), IsOk());
  EXPECT_THAT(Ask(request).granted, SizeIs(4)) << "it is not the worker that was drained";
}

}  // namespace
}  // namespace craftfleet
