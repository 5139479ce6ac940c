#include "learner/training/weight_store.h"

#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/mutex.h"

namespace craftfleet {
namespace {

std::shared_ptr<const std::string> Bytes(int64_t version) {
  return std::make_shared<std::string>("weights " + std::to_string(version));
}

TEST(WeightStore, HasNothingBeforeTheFirstVersion) {
  WeightStore store;
  const WeightStore::Weights weights = store.Find(0);
  EXPECT_EQ(weights.version, -1);
  EXPECT_EQ(weights.bytes, nullptr);
}

TEST(WeightStore, ReturnsAnAvailableVersionAtOnce) {
  WeightStore store;
  store.Publish(3, Bytes(3));
  store.Publish(4, Bytes(4));
  for (const int64_t wanted : {0, 3, 4}) {
    const WeightStore::Weights weights = store.Find(wanted);
    EXPECT_EQ(weights.version, 4);
    EXPECT_EQ(*weights.bytes, "weights 4");
  }
}

TEST(WeightStore, ReturnsTheLatestVersionInsteadOfOneToCome) {
  WeightStore store;
  store.Publish(3, Bytes(3));
  EXPECT_EQ(store.Find(4).version, 3);
}

TEST(WeightStore, ReturnedBytesStayValid) {
  WeightStore store;
  store.Publish(1, Bytes(1));
  const WeightStore::Weights taken = store.Find(1);
  store.Publish(2, Bytes(2));
  EXPECT_EQ(*taken.bytes, "weights 1");
}

TEST(WeightStore, KeepsTheVersionsThatAreWanted) {
  WeightStore store(/*kept=*/2);
  for (int version = 1; version <= 3; ++version) store.Publish(version, Bytes(version));
  EXPECT_EQ(store.Find(1).version, 3);
  EXPECT_EQ(store.Find(2).version, 2);
  EXPECT_EQ(*store.Find(2).bytes, "weights 2");
  EXPECT_EQ(store.Find(3).version, 3);
  EXPECT_EQ(store.Find(4).version, 3);
}

TEST(WeightStore, TheObserverSeesEachVersion) {
  constexpr int64_t kVersions = 200;
  WeightStore store;
  Mutex mu;
  CondVar changed;
  int64_t published = 0;
  store.SetObserver([&] {
    const MutexLock lock(&mu);
    ++published;
    changed.NotifyAll();
  });
  std::vector<std::thread> readers;
  readers.reserve(4);
  for (int r = 0; r < 4; ++r) {
    readers.emplace_back([&] {
      for (int64_t version = 0; version < kVersions;) {
        {
          const MutexLock lock(&mu);
          changed.Wait(&mu, [&] { return published > version; });
        }
        const WeightStore::Weights weights = store.Find(version);
        EXPECT_GE(weights.version, version);
        EXPECT_EQ(*weights.bytes, *Bytes(weights.version));
        version = weights.version + 1;
      }
    });
  }
  for (int64_t version = 0; version < kVersions; ++version) store.Publish(version, Bytes(version));
  for (std::thread& reader : readers) reader.join();
  EXPECT_EQ(published, kVersions);
  store.SetObserver(nullptr);
  store.Publish(kVersions, Bytes(kVersions));
  EXPECT_EQ(published, kVersions);
}

}  // namespace
}  // namespace craftfleet
