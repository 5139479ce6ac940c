#include "learner/weight_store.h"

#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

std::shared_ptr<const std::string> Bytes(int64_t version) {
  return std::make_shared<std::string>("weights " + std::to_string(version));
}

TEST(WeightStore, HasNothingBeforeTheFirstVersion) {
  WeightStore store;
  const WeightStore::Weights weights = store.Wait(0, absl::Milliseconds(5));
  EXPECT_EQ(weights.version, -1);
  EXPECT_EQ(weights.bytes, nullptr);
}

TEST(WeightStore, ReturnsAnAvailableVersionAtOnce) {
  WeightStore store;
  store.Publish(3, Bytes(3));
  store.Publish(4, Bytes(4));
  for (const int64_t wanted : {0, 3, 4}) {
    const WeightStore::Weights weights = store.Wait(wanted, absl::InfiniteDuration());
    EXPECT_EQ(weights.version, 4);
    EXPECT_EQ(*weights.bytes, "weights 4");
  }
}

TEST(WeightStore, ReturnsTheLatestVersionAfterATimeout) {
  WeightStore store;
  store.Publish(3, Bytes(3));
  EXPECT_EQ(store.Wait(4, absl::Milliseconds(5)).version, 3);
}

TEST(WeightStore, ReturnedBytesStayValid) {
  WeightStore store;
  store.Publish(1, Bytes(1));
  const WeightStore::Weights taken = store.Wait(1, absl::ZeroDuration());
  store.Publish(2, Bytes(2));
  EXPECT_EQ(*taken.bytes, "weights 1");
}

TEST(WeightStore, KeepsTheVersionsThatAreWanted) {
  WeightStore store(/*kept=*/2);
  for (int version = 1; version <= 3; ++version) store.Publish(version, Bytes(version));
  EXPECT_EQ(store.Wait(1, absl::ZeroDuration()).version, 3);
  EXPECT_EQ(store.Wait(2, absl::ZeroDuration()).version, 2);
  EXPECT_EQ(*store.Wait(2, absl::ZeroDuration()).bytes, "weights 2");
  EXPECT_EQ(store.Wait(3, absl::ZeroDuration()).version, 3);
  EXPECT_EQ(store.Wait(4, absl::ZeroDuration()).version, 3);
}

TEST(WeightStore, PublishWakesWaitingCalls) {
  constexpr int64_t kVersions = 200;
  WeightStore store;
  std::vector<std::thread> readers;
  readers.reserve(4);
  for (int r = 0; r < 4; ++r) {
    readers.emplace_back([&store] {
      for (int64_t version = 0; version < kVersions;) {
        const WeightStore::Weights weights = store.Wait(version, absl::InfiniteDuration());
        EXPECT_GE(weights.version, version);
        EXPECT_EQ(*weights.bytes, *Bytes(weights.version));
        version = weights.version + 1;
      }
    });
  }
  for (int64_t version = 0; version < kVersions; ++version) store.Publish(version, Bytes(version));
  for (std::thread& reader : readers) reader.join();
}

}  // namespace
}  // namespace craftfleet
