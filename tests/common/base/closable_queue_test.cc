#include "common/base/closable_queue.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::ElementsAreArray;
using testing::HasSubstr;

TEST(ClosableQueue, ReturnsItemsInOrder) {
  ClosableQueue<int> queue(3);
  for (const int item : {7, 5, 6}) ASSERT_THAT(queue.Push(item), IsOk());
  EXPECT_EQ(queue.size(), 3);
  for (const int item : {7, 5, 6}) EXPECT_EQ(queue.Pop(absl::ZeroDuration()), item);
  EXPECT_EQ(queue.Pop(absl::ZeroDuration()), std::nullopt);
}

TEST(ClosableQueue, SupportsMoveOnlyItems) {
  ClosableQueue<std::unique_ptr<int>> queue(1);
  ASSERT_THAT(queue.Push(std::make_unique<int>(4)), IsOk());
  EXPECT_EQ(**queue.Pop(absl::ZeroDuration()), 4);
}

TEST(ClosableQueue, PopReturnsNothingAfterItsTimeout) {
  ClosableQueue<int> queue(1);
  EXPECT_EQ(queue.Pop(absl::Milliseconds(20)), std::nullopt);
  EXPECT_THAT(queue.Push(1), IsOk()) << "it is not closed";
}

TEST(ClosableQueue, PushWaitsForRoom) {
  ClosableQueue<int> queue(1);
  ASSERT_THAT(queue.Push(1), IsOk());
  std::atomic<bool> pushed{false};
  std::thread pusher([&] {
    EXPECT_THAT(queue.Push(2), IsOk());
    pushed = true;
  });
  // The item cannot have been pushed: the queue is full until the Pop below.
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_FALSE(pushed);
  EXPECT_EQ(queue.size(), 1);
  EXPECT_EQ(queue.Pop(absl::ZeroDuration()), 1);
  EXPECT_EQ(queue.Pop(absl::Seconds(30)), 2);
  pusher.join();
}

TEST(ClosableQueue, CloseWakesBlockedPush) {
  ClosableQueue<int> queue(1);
  ASSERT_THAT(queue.Push(1), IsOk());
  absl::Status pushed;
  std::thread pusher([&] { pushed = queue.Push(2); });
  queue.Close();
  pusher.join();
  EXPECT_THAT(pushed, StatusIs(absl::StatusCode::kCancelled, HasSubstr("queue closed")));
  EXPECT_EQ(queue.size(), 1);
}

TEST(ClosableQueue, CloseWakesEveryBlockedPop) {
  ClosableQueue<int> queue(1);
  std::vector<std::thread> poppers;
  poppers.reserve(4);
  for (int i = 0; i < 4; ++i) {
    poppers.emplace_back([&] { EXPECT_EQ(queue.Pop(absl::InfiniteDuration()), std::nullopt); });
  }
  queue.Close();
  for (std::thread& popper : poppers) popper.join();
}

TEST(ClosableQueue, QueuedItemsCanBePoppedAfterClose) {
  ClosableQueue<int> queue(2);
  ASSERT_THAT(queue.Push(1), IsOk());
  ASSERT_THAT(queue.Push(2), IsOk());
  queue.Close();
  queue.Close();
  EXPECT_THAT(queue.Push(3), StatusIs(absl::StatusCode::kCancelled, HasSubstr("closed")));
  EXPECT_EQ(queue.Pop(absl::InfiniteDuration()), 1);
  EXPECT_EQ(queue.Pop(absl::InfiniteDuration()), 2);
  EXPECT_EQ(queue.Pop(absl::InfiniteDuration()), std::nullopt);
}

// Each producer's items stay in order, and each item arrives once.
TEST(ClosableQueue, DeliversEachItemExactlyOnceAcrossThreads) {
  constexpr int kProducers = 4;
  constexpr int kConsumers = 3;
  constexpr int kItems = 2000;
  ClosableQueue<int> queue(5);
  std::vector<std::thread> producers;
  producers.reserve(kProducers);
  for (int p = 0; p < kProducers; ++p) {
    producers.emplace_back([&queue, p] {
      for (int i = 0; i < kItems; ++i) ASSERT_THAT(queue.Push(p * kItems + i), IsOk());
    });
  }
  std::vector<std::vector<int>> got(kConsumers);
  std::vector<std::thread> consumers;
  consumers.reserve(kConsumers);
  for (int c = 0; c < kConsumers; ++c) {
    consumers.emplace_back([&queue, &mine = got[c]] {
      while (const auto item = queue.Pop(absl::InfiniteDuration())) mine.push_back(*item);
    });
  }
  for (std::thread& producer : producers) producer.join();
  queue.Close();
  for (std::thread& consumer : consumers) consumer.join();

  std::vector<int> all;
  for (const std::vector<int>& mine : got) {
    std::vector<int> last(kProducers, -1);
    for (const int item : mine) {
      EXPECT_GT(item, last[item / kItems]);
      last[item / kItems] = item;
    }
    all.insert(all.end(), mine.begin(), mine.end());
  }
  std::sort(all.begin(), all.end());
  std::vector<int> wanted(kProducers * kItems);
  for (size_t i = 0; i < wanted.size(); ++i) wanted[i] = static_cast<int>(i);
  EXPECT_THAT(all, ElementsAreArray(wanted));
}

}  // namespace
}  // namespace craftfleet
