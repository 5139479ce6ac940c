// Requests for permits that wait in WaitingCalls, as LearnerServiceImpl has them wait.
#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/closable_queue.h"
#include "common/base/waiting_calls.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

using testing::IsEmpty;
using testing::SizeIs;
using Reply = absl::StatusOr<WorkerRegistry::PermitReply>;

constexpr int kLanes = 8;

class WaitingPermitsTest : public testing::Test {
 protected:
  WaitingPermitsTest() {
    registry_.SetObserver([this](absl::string_view actor) {
      if (actor.empty()) {
        waiters_->Retry();
      } else {
        waiters_->Retry(actor);
      }
    });
  }
  ~WaitingPermitsTest() override { registry_.SetObserver(nullptr); }

  void Ask(const std::string& actor, absl::Duration wait, std::function<void(Reply)> answer) {
    waiters_->Add(
        [this, request = TestRegistry::RequestOf(actor, {}, kLanes), answer = std::move(answer),
         started = false](bool last) mutable {
          std::optional<Reply> reply = registry_.TryPermits(request, !std::exchange(started, true), last);
          if (reply.has_value()) answer(*std::move(reply));
          return reply.has_value();
        },
        wait, actor);
  }
  void Ask(const std::string& actor, absl::Duration wait) {
    Ask(actor, wait, [this](Reply reply) { replies_.Push(std::move(reply)).IgnoreError(); });
  }
  Reply Next() {
    auto reply = replies_.Pop(absl::Seconds(60));
    return reply.has_value() ? *std::move(reply) : absl::DeadlineExceededError("no reply");
  }

  FakeClock clock_;
  TestRegistry registry_{{kLanes}, std::vector<LaneRecord>(kLanes), &clock_};
  ClosableQueue<Reply> replies_{1000};
  std::unique_ptr<WaitingCalls> waiters_ = std::make_unique<WaitingCalls>();
};

TEST_F(WaitingPermitsTest, ARequestIsAnsweredAtOnceIfThereArePermits) {
  registry_.Join("a", "");
  registry_.OpenIteration(2, 1);
  Ask("a", absl::InfiniteDuration());
  EXPECT_THAT(Next()->granted, SizeIs(kLanes));
  EXPECT_EQ(waiters_->size(), 0);
}

TEST_F(WaitingPermitsTest, ARequestWaitsForTheNextIteration) {
  registry_.Join("a", "");
  Ask("a", absl::InfiniteDuration());
  EXPECT_EQ(replies_.size(), 0);
  registry_.OpenIteration(2, 1);
  EXPECT_THAT(Next()->granted, SizeIs(kLanes));
}

TEST_F(WaitingPermitsTest, AnAcceptedFragmentConcernsItsSenderAloneUnlessItsLaneIsFree) {
  for (const char* actor : {"a", "b"}) registry_.Join(actor, "");
  registry_.OpenIteration(2, 1);
  std::map<std::string, std::vector<Permit>> granted;
  for (const char* actor : {"a", "b"}) {
    Ask(actor, absl::InfiniteDuration());
    granted[actor] = Next()->granted;
    ASSERT_THAT(granted[actor], SizeIs(kLanes / 2));
  }
  std::vector<std::string> concerned;
  registry_.SetObserver([&](absl::string_view actor) { concerned.emplace_back(actor); });
  EXPECT_THAT(registry_.Accept("a", granted["a"][0], {}), IsOk());
  EXPECT_EQ(concerned, std::vector<std::string>{"a"});
  registry_.Drain("b");
  concerned.clear();
  EXPECT_THAT(registry_.Accept("b", granted["b"][0], {}), IsOk());
  EXPECT_EQ(concerned, std::vector<std::string>{""}) << "anyone may have it";
}

TEST_F(WaitingPermitsTest, ARequestThatGetsNothingIsAnsweredAfterItsWait) {
  registry_.Join("a", "");
  registry_.Join("b", "");
  Ask("a", absl::InfiniteDuration());
  Ask("b", absl::Milliseconds(20));
  const Reply reply = Next();
  ASSERT_THAT(reply, IsOk());
  EXPECT_THAT(reply->granted, IsEmpty());
  Ask("b", absl::ZeroDuration());
  EXPECT_THAT(Next()->granted, IsEmpty());
  EXPECT_EQ(waiters_->size(), 1) << "a's request";
}

TEST_F(WaitingPermitsTest, ErrorsAreAnswersToo) {
  Ask("stranger", absl::InfiniteDuration());
  EXPECT_THAT(Next(), StatusIs(absl::StatusCode::kAborted, testing::HasSubstr("join")));
  registry_.Join("a", "");
  Ask("a", absl::InfiniteDuration());
  registry_.Leave("a");
  EXPECT_THAT(Next(), StatusIs(absl::StatusCode::kAborted, testing::HasSubstr("join again")));
}

TEST_F(WaitingPermitsTest, AClosedRegistryAnswersAll) {
  registry_.Join("a", "");
  registry_.Join("b", "");
  Ask("a", absl::InfiniteDuration());
  Ask("b", absl::InfiniteDuration());
  registry_.Close();
  registry_.OpenIteration(1, 1);
  Ask("a", absl::ZeroDuration());
  for (int i = 0; i < 3; ++i) {
    EXPECT_THAT(Next(), StatusIs(absl::StatusCode::kUnavailable, testing::HasSubstr("stopping")));
  }
}

TEST_F(WaitingPermitsTest, DestructionAnswersAll) {
  registry_.Join("a", "");
  registry_.Join("b", "");
  Ask("a", absl::InfiniteDuration());
  Ask("b", absl::InfiniteDuration());
  registry_.SetObserver(nullptr);
  waiters_.reset();
  EXPECT_THAT(Next()->granted, IsEmpty());
  EXPECT_THAT(Next()->granted, IsEmpty());
}

// Actors on threads of their own ask with random waits while iterations open: each request has one answer, and each
// fragment is granted once.
TEST_F(WaitingPermitsTest, EveryRequestOfManyThreadsIsAnsweredOnce) {
  constexpr int kActors = 4;
  constexpr int kIterations = 50;
  for (int i = 0; i < kActors; ++i) registry_.Join(absl::StrCat("actor", i), "");
  Mutex mu;
  std::map<std::pair<int, int64_t>, int> grants;
  std::atomic<int64_t> asked = 0;
  std::atomic<int64_t> answered = 0;
  std::atomic<bool> over = false;
  std::vector<std::thread> actors;
  for (int i = 0; i < kActors; ++i) {
    actors.emplace_back([&, i] {
      std::mt19937 random(i);
      const std::string name = absl::StrCat("actor", i);
      while (!over) {
        ClosableQueue<Reply> mine(2);
        ++asked;
        Ask(name, absl::Microseconds(random() % 3000), [&](Reply reply) {
          ++answered;
          mine.Push(std::move(reply)).IgnoreError();
        });
        const auto reply = mine.Pop(absl::Seconds(60));
        ASSERT_TRUE(reply.has_value());
        ASSERT_THAT(*reply, IsOk());
        for (const Permit& permit : (*reply)->granted) {
          {
            const MutexLock lock(&mu);
            ++grants[{permit.lane, permit.fragment}];
          }
          EXPECT_THAT(registry_.Accept(name, permit, {}), IsOk());
        }
      }
    });
  }
  for (int64_t iteration = 1; iteration <= kIterations; ++iteration) {
    registry_.OpenIteration(iteration, iteration);
    const absl::Time start = absl::Now();
    for (bool complete = false; !complete && absl::Now() - start < absl::Seconds(60);
         absl::SleepFor(absl::Milliseconds(1))) {
      const MutexLock lock(&mu);
      complete = grants.size() == static_cast<size_t>(kLanes * iteration);
    }
  }
  over = true;
  for (std::thread& actor : actors) actor.join();
  EXPECT_EQ(asked, answered);
  EXPECT_EQ(grants.size(), kLanes * kIterations);
  for (const auto& [fragment, count] : grants) EXPECT_EQ(count, 1) << fragment.first << " " << fragment.second;
}

}  // namespace
}  // namespace craftfleet
