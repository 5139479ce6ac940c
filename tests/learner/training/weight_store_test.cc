#include "learner/training/weight_store.h"

#include <string>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

std::shared_ptr<const PolicyWeights> WeightsOf(int64_t version) {
  return std::make_shared<HostWeights>("weights " + std::to_string(version));
}

TEST(WeightStore, HasNothingBeforeTheFirstVersion) {
  WeightStore store;
  const WeightStore::Weights weights = store.Find(0);
  EXPECT_EQ(weights.version, -1);
  EXPECT_EQ(weights.weights, nullptr);
}

TEST(WeightStore, ReturnsAnAvailableVersionAtOnce) {
  WeightStore store;
  store.Publish(3, WeightsOf(3));
  store.Publish(4, WeightsOf(4));
  for (const int64_t wanted : {0, 3, 4}) {
    const WeightStore::Weights weights = store.Find(wanted);
    EXPECT_EQ(weights.version, 4);
    EXPECT_EQ(**weights.weights->Bytes(), "weights 4");
  }
}

TEST(WeightStore, KeepsTheVersionsThatAreWanted) {
  WeightStore store(/*kept=*/2);
  for (int version = 1; version <= 3; ++version) store.Publish(version, WeightsOf(version));
  EXPECT_EQ(store.Find(1).version, 3);
  EXPECT_EQ(store.Find(2).version, 2);
  EXPECT_EQ(**store.Find(2).weights->Bytes(), "weights 2");
  EXPECT_EQ(store.Find(3).version, 3);
  EXPECT_EQ(store.Find(4).version, 3);
}

}  // namespace
}  // namespace craftfleet
