// Actors that come, go, give up and die while the learner's book stays right.

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

#include "common/mutex.h"
#include "learner/lane_ledger.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

constexpr int kLanes = 24;
constexpr int kIterations = 15;
constexpr int64_t kFragmentsPerIteration = 3;

// How often each fragment was accepted, and the trainer's side of the book.
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

// An actor that loses its nerve now and then. Restarts under new names.
class WildActor {
 public:
  WildActor(int number, LaneLedger* ledger, Referee* referee)
      : name_(absl::StrCat("actor ", number)), ledger_(ledger), referee_(referee), random_(number) {}

  void Run() {
    for (int life = 0; !Live(absl::StrCat(name_, " life ", life)); ++life) {
    }
  }

 private:
  bool Chance(int percent) { return static_cast<int>(random_() % 100) < percent; }

  // True: the run is over.
  bool Live(const std::string& name) {
    ledger_->Join(name, "");
    std::vector<Permit> active;
    while (true) {
      const int capacity = static_cast<int>(1 + random_() % kLanes);
      const auto grant = ledger_->GetPermits(name, active, capacity, absl::Milliseconds(1));
      if (!grant.ok()) return false;  // its lease lapsed
      if (grant->finished) {
        ledger_->Leave(name);
        return true;
      }
      for (const Permit& lost : grant->lost) active.erase(std::find(active.begin(), active.end(), lost));
      active.insert(active.end(), grant->granted.begin(), grant->granted.end());
      if (Chance(2)) {  // dies without a word; its connection may show it
        if (Chance(50)) ledger_->LoseTouch(name);
        return false;
      }
      if (Chance(4)) {
        ledger_->Leave(name);
        return false;
      }
      Play(name, &active);
    }
  }

  // Sends some fragments, some of them twice, and gives some back.
  void Play(const std::string& name, std::vector<Permit>* active) {
    std::vector<Permit> kept;
    for (const Permit& permit : *active) {
      if (Chance(30)) {
        kept.push_back(permit);
        continue;
      }
      if (Chance(10)) continue;
      for (int times = Chance(20) ? 2 : 1; times > 0; --times) {
        const auto verdict = ledger_->Accept(name, permit, {absl::StrCat(permit.lane, "/", permit.fragment + 1), {}});
        ASSERT_THAT(verdict, IsOk());
        if (*verdict == LaneLedger::Verdict::kAccepted) referee_->Count(permit);
      }
    }
    *active = std::move(kept);
  }

  const std::string name_;
  LaneLedger* const ledger_;
  Referee* const referee_;
  std::mt19937 random_;
};

TEST(LaneLedgerThreads, EveryFragmentIsAcceptedExactlyOnce) {
  FakeClock clock;
  LaneLedger ledger({kLanes, absl::Seconds(5), absl::Seconds(1)}, std::vector<LaneRecord>(kLanes), &clock);
  Referee referee;
  ledger.OpenIteration(kFragmentsPerIteration, 0);
  std::vector<std::thread> actors;
  actors.reserve(8);
  for (int number = 0; number < 8; ++number) {
    actors.emplace_back([&ledger, &referee, number] { WildActor(number, &ledger, &referee).Run(); });
  }
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const auto wanted = static_cast<size_t>(kLanes * kFragmentsPerIteration * (iteration + 1));
    // The clock runs much faster than the actors, so that leases of the silent ones lapse.
    for (int i = 0; !referee.WaitFor(wanted, absl::Milliseconds(2)); ++i) {
      ASSERT_LT(i, 20000) << "no progress";
      clock.Advance(absl::Milliseconds(300));
    }
    ASSERT_EQ(ledger.permits(), 0);
    for (int lane = 0; lane < kLanes; ++lane) {
      const int64_t next = kFragmentsPerIteration * (iteration + 1);
      ASSERT_EQ(ledger.Records()[lane].next_fragment, next);
      ASSERT_EQ(ledger.Snapshot(lane, next).value().game, absl::StrCat(lane, "/", next));
    }
    ledger.OpenIteration(kFragmentsPerIteration * (iteration + 2), iteration + 1);
  }
  ledger.Finish();
  for (std::thread& actor : actors) actor.join();
  for (const auto& [fragment, times] : referee.accepted()) {
    EXPECT_EQ(times, 1) << "lane " << fragment.first << " fragment " << fragment.second;
  }
}

}  // namespace
}  // namespace craftfleet
