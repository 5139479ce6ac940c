// Large arrays of floats that are taken and given back often, such as what a layer keeps between its forward and its
// backward pass. New memory would cost a page fault every 4 KiB each time.

#pragma once

#include <cstddef>
#include <cstdint>

namespace craftfleet {

// Uninitialised memory for `floats` floats in huge pages, aligned to one; back to a pool of the process at the end.
// The pool holds as many arrays as have been in use at once, until FreeUnused. Movable; the pool is thread-safe.
class PooledBuffer {
 public:
  // >= 0. Throws std::bad_alloc, as LibTorch's tensors do.
  explicit PooledBuffer(int64_t floats);
  ~PooledBuffer();
  PooledBuffer(PooledBuffer&& other) noexcept : data_(other.data_), bytes_(other.bytes_) { other.data_ = nullptr; }
  PooledBuffer& operator=(PooledBuffer&&) = delete;
  PooledBuffer(const PooledBuffer&) = delete;
  PooledBuffer& operator=(const PooledBuffer&) = delete;

  float* get() const { return data_; }

  // Frees the pool's arrays that are not in use if they are `least_bytes` or more together. Returns the bytes freed.
  static size_t FreeUnused(size_t least_bytes);

 private:
  float* data_;
  size_t bytes_;
};

}  // namespace craftfleet
