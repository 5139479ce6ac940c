#include "common/agent/pooled_buffer.h"

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <utility>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

constexpr int64_t kFloats = 3 << 20;  // a size that no other code of this process uses

TEST(PooledBuffer, IsAlignedAndWritable) {
  const PooledBuffer buffer(kFloats);
  EXPECT_EQ(reinterpret_cast<uintptr_t>(buffer.get()) % 64, 0U);
  std::memset(buffer.get(), 1, kFloats * sizeof(float));
  EXPECT_NE(PooledBuffer(0).get(), nullptr);
}

TEST(PooledBuffer, MemoryIsUsedAgain) {
  const float* first = nullptr;
  {
    const PooledBuffer buffer(kFloats);
    first = buffer.get();
  }
  const PooledBuffer again(kFloats);
  EXPECT_EQ(again.get(), first);
  const PooledBuffer other(kFloats);
  EXPECT_NE(other.get(), first) << "in use";
}

TEST(PooledBuffer, ALargerOneMayServe) {
  const float* first = nullptr;
  {
    const PooledBuffer buffer(8 * kFloats);
    first = buffer.get();
  }
  const PooledBuffer smaller(5 * kFloats);
  EXPECT_EQ(smaller.get(), first);
}

TEST(PooledBuffer, UnusedMemoryIsFreedIfThereIsEnoughOfIt) {
  const PooledBuffer used(kFloats);
  { const PooledBuffer unused(kFloats); }
  EXPECT_EQ(PooledBuffer::FreeUnused(std::numeric_limits<size_t>::max()), 0U);
  EXPECT_GE(PooledBuffer::FreeUnused(kFloats * sizeof(float)), kFloats * sizeof(float));
  EXPECT_EQ(PooledBuffer::FreeUnused(1), 0U);
  std::memset(used.get(), 1, kFloats * sizeof(float));
}

TEST(PooledBuffer, AMoveKeepsTheMemory) {
  PooledBuffer buffer(kFloats);
  const float* const data = buffer.get();
  const PooledBuffer moved(std::move(buffer));
  EXPECT_EQ(moved.get(), data);
}

}  // namespace
}  // namespace craftfleet
