// Actors join, leave, return permits and crash in many threads, while the registry stays consistent.

#include <algorithm>
#include <map>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/mutex.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

constexpr int kLanes = 24;
constexpr int kIterations = 15;
constexpr int64_t kFragmentsPerIteration = 3;

// Counts how often each fragment was accepted, and acts as the trainer.
class Referee {
 public:
  void Count(const Permit& permit) {
    const MutexLock lock(&mu_);
    ++accepted_[{permit.lane, permit.fragment}];
    changed_.NotifyAll();
  }
  bool WaitFor(size_t fragments, absl::Duration timeout) {
    const MutexLock lock(&mu_);
    return changed_.WaitFor(&mu_, timeout,
                            [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return accepted_.size() >= fragments; });
  }
  std::map<std::pair<int, int64_t>, int> accepted() {
    const MutexLock lock(&mu_);
    return accepted_;
  }

 private:
  Mutex mu_;
  CondVar changed_;
  std::map<std::pair<int, int64_t>, int> accepted_ ABSL_GUARDED_BY(mu_);
};

// An actor that fails at random and restarts under new names.
class WildActor {
 public:
  WildActor(int number, TestRegistry* registry, Referee* referee)
      : name_(absl::StrCat("actor ", number)), registry_(registry), referee_(referee), random_(number) {}

  void Run() {
    for (int life = 0; !Live(absl::StrCat(name_, " life ", life)); ++life) {
    }
  }

 private:
  bool Chance(int percent) { return static_cast<int>(random_() % 100) < percent; }

  // Returns true if the run is over.
  bool Live(const std::string& name) {
    registry_->Join(name, "");
    std::vector<Permit> active;
    while (true) {
      const int capacity = static_cast<int>(1 + random_() % kLanes);
      const auto grant = registry_->GetPermits(name, active, capacity, absl::Milliseconds(1));
      if (!grant.ok()) return false;  // its lease lapsed
      if (grant->finished) {
        registry_->Leave(name);
        return true;
      }
      for (const Permit& lost : grant->lost) active.erase(std::find(active.begin(), active.end(), lost));
      active.insert(active.end(), grant->granted.begin(), grant->granted.end());
      if (Chance(2)) {  // crashes; its connection may break
        if (Chance(50)) registry_->OnConnectionLost(name);
        return false;
      }
      if (Chance(4)) {
        registry_->Leave(name);
        return false;
      }
      Play(name, &active);
    }
  }

  // Sends some fragments, some of them twice, and returns some permits.
  void Play(const std::string& name, std::vector<Permit>* active) {
    std::vector<Permit> kept;
    for (const Permit& permit : *active) {
      if (Chance(30)) {
        kept.push_back(permit);
        continue;
      }
      if (Chance(10)) continue;
      for (int times = Chance(20) ? 2 : 1; times > 0; --times) {
        const auto verdict = registry_->Accept(name, permit, {absl::StrCat(permit.lane, "/", permit.fragment + 1), {}});
        ASSERT_THAT(verdict, IsOk());
        if (*verdict == LaneScheduler::Verdict::kAccepted) referee_->Count(permit);
      }
    }
    *active = std::move(kept);
  }

  const std::string name_;
  TestRegistry* const registry_;
  Referee* const referee_;
  std::mt19937 random_;
};

TEST(LaneSchedulerThreads, EveryFragmentIsAcceptedExactlyOnce) {
  FakeClock clock;
  TestRegistry registry({kLanes, absl::Seconds(5), absl::Seconds(1)}, std::vector<LaneRecord>(kLanes), &clock);
  Referee referee;
  registry.OpenIteration(kFragmentsPerIteration, 0);
  std::vector<std::thread> actors;
  actors.reserve(8);
  for (int number = 0; number < 8; ++number) {
    actors.emplace_back([&registry, &referee, number] { WildActor(number, &registry, &referee).Run(); });
  }
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const auto wanted = static_cast<size_t>(kLanes * kFragmentsPerIteration * (iteration + 1));
    // The clock runs much faster than the actors, so that leases of silent actors expire.
    for (int i = 0; !referee.WaitFor(wanted, absl::Milliseconds(2)); ++i) {
      ASSERT_LT(i, 20000) << "no progress";
      clock.Advance(absl::Milliseconds(300));
    }
    ASSERT_EQ(registry.permits(), 0);
    for (int lane = 0; lane < kLanes; ++lane) {
      const int64_t next = kFragmentsPerIteration * (iteration + 1);
      ASSERT_EQ(registry.Records()[lane].next_fragment, next);
      ASSERT_EQ(registry.Snapshot(lane, next).value().game, absl::StrCat(lane, "/", next));
    }
    registry.OpenIteration(kFragmentsPerIteration * (iteration + 2), iteration + 1);
  }
  registry.Finish();
  for (std::thread& actor : actors) actor.join();
  for (const auto& [fragment, times] : referee.accepted()) {
    EXPECT_EQ(times, 1) << "lane " << fragment.first << " fragment " << fragment.second;
  }
}

}  // namespace
}  // namespace craftfleet
