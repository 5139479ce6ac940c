#include "common/agent/pooled_buffer.h"

#include <sys/mman.h>

#include <cstdlib>
#include <iterator>
#include <map>
#include <new>

#include "common/base/mutex.h"

namespace craftfleet {
namespace {

constexpr size_t kHugePage = size_t{2} << 20;

float* Allocate(size_t bytes) {
  void* const data = std::aligned_alloc(kHugePage, bytes);
  if (data == nullptr) throw std::bad_alloc();
  madvise(data, bytes, MADV_HUGEPAGE);  // an error means small pages: slower
  return static_cast<float*>(data);
}

class Pool {
 public:
  // Sets `bytes` to the size of what it returns: at least as many.
  float* Take(size_t* bytes) ABSL_LOCKS_EXCLUDED(mu_) {
    {
      const MutexLock lock(&mu_);
      const auto found = free_.lower_bound(*bytes);
      if (found != free_.end() && found->first <= 2 * *bytes) {
        float* const data = found->second;
        *bytes = found->first;
        free_.erase(found);
        return data;
      }
      // A larger one instead of the largest that is too small, so that sizes which vary don't fill the memory.
      if (found != free_.begin()) {
        const auto replaced = std::prev(found);
        std::free(replaced->second);
        free_.erase(replaced);
      }
    }
    return Allocate(*bytes);
  }

  void Return(float* data, size_t bytes) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    free_.emplace_hint(free_.lower_bound(bytes), bytes, data);  // the newest first: it may still be in a cache
  }

  size_t FreeUnused(size_t least_bytes) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    size_t bytes = 0;
    for (const auto& [size, data] : free_) bytes += size;
    if (bytes < least_bytes) return 0;
    for (const auto& [size, data] : free_) std::free(data);
    free_.clear();
    return bytes;
  }

 private:
  Mutex mu_;
  std::multimap<size_t, float*> free_ ABSL_GUARDED_BY(mu_);  // by size in bytes
};

Pool& ThePool() {
  static Pool& pool = *new Pool;
  return pool;
}

}  // namespace

PooledBuffer::PooledBuffer(int64_t floats) : bytes_((floats * sizeof(float) / kHugePage + 1) * kHugePage) {
  data_ = ThePool().Take(&bytes_);
}

size_t PooledBuffer::FreeUnused(size_t least_bytes) { return ThePool().FreeUnused(least_bytes); }

PooledBuffer::~PooledBuffer() {
  if (data_ != nullptr) ThePool().Return(data_, bytes_);
}

}  // namespace craftfleet
