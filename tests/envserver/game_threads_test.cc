#include "envserver/game_threads.h"

#include <atomic>
#include <functional>
#include <future>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;

// Keeps a thread until it is told to go on. Outlives the threads.
class Obstacle {
 public:
  // Returns when a thread has reached it.
  void Block(GameThreads* threads) {
    threads->Add([this] {
      reached_.set_value();
      removed_.get_future().wait();
    });
    reached_.get_future().wait();
  }
  void Remove() { removed_.set_value(); }

 private:
  std::promise<void> reached_;
  std::promise<void> removed_;
};

TEST(GameThreads, RunsJobsInTheirOrder) {
  std::vector<int> done;
  Obstacle obstacle;
  {
    GameThreads threads(1);
    obstacle.Block(&threads);
    for (int i = 0; i < 3; ++i) threads.Add([&done, i] { done.push_back(i); });
    obstacle.Remove();
  }
  EXPECT_THAT(done, ElementsAre(0, 1, 2));
}

TEST(GameThreads, RunsAJobWhileOthersTakeLong) {
  Obstacle first;
  Obstacle second;
  std::promise<void> done;
  GameThreads threads(3);
  first.Block(&threads);
  second.Block(&threads);
  threads.Add([&] { done.set_value(); });
  done.get_future().wait();
  first.Remove();
  second.Remove();
}

TEST(GameThreads, AJobThatAddsItsRestLetsOthersRunBefore) {
  std::vector<int> done;
  Obstacle obstacle;
  std::function<void()> long_job;
  {
    GameThreads threads(1);
    obstacle.Block(&threads);
    long_job = [&] {
      done.push_back(1);
      if (threads.others_wait()) threads.Add(long_job);
    };
    threads.Add(long_job);
    threads.Add([&] { done.push_back(2); });
    EXPECT_TRUE(threads.others_wait());
    obstacle.Remove();
  }
  EXPECT_THAT(done, ElementsAre(1, 2, 1));
}

TEST(GameThreads, TheDestructorRunsWhatWaits) {
  std::atomic<int> done{0};
  {
    GameThreads threads(2);
    for (int i = 0; i < 100; ++i) threads.Add([&] { ++done; });
  }
  EXPECT_EQ(done, 100);
}

}  // namespace
}  // namespace craftfleet
