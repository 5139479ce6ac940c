#include "envserver/game_threads.h"

#include <atomic>
#include <functional>
#include <future>
#include <memory>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;

// Keeps a thread until it is told to go on.
class Obstacle {
 public:
  explicit Obstacle(GameThreads* threads) {
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
  {
    GameThreads threads(1);
    Obstacle obstacle(&threads);
    for (int i = 0; i < 3; ++i) threads.Add([&done, i] { done.push_back(i); });
    obstacle.Remove();
  }
  EXPECT_THAT(done, ElementsAre(0, 1, 2));
}

TEST(GameThreads, RunsAJobWhileOthersTakeLong) {
  GameThreads threads(3);
  Obstacle first(&threads);
  Obstacle second(&threads);
  std::promise<void> done;
  threads.Add([&] { done.set_value(); });
  done.get_future().wait();
  first.Remove();
  second.Remove();
}

TEST(GameThreads, AJobThatAddsItsRestLetsOthersRunBefore) {
  std::vector<int> done;
  {
    GameThreads threads(1);
    Obstacle obstacle(&threads);
    std::function<void()> long_job = [&] {
      done.push_back(1);
      if (threads.others_wait()) threads.Add(long_job);
    };
    threads.Add(long_job);
    threads.Add([&] { done.push_back(2); });
    EXPECT_TRUE(threads.others_wait());
    obstacle.Remove();
    std::promise<void> last;
    threads.Add([&] { last.set_value(); });
    last.get_future().wait();
    while (threads.others_wait()) {
    }
  }
  EXPECT_EQ(done[0], 1);
  EXPECT_EQ(done[1], 2);
  EXPECT_EQ(done.back(), 1);
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
