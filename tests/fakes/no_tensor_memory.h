// Makes LibTorch fail like on a machine without memory.

#pragma once

#include <cstddef>
#include <deque>
#include <new>
#include <thread>

#include <c10/core/CPUAllocator.h>
#include <torch/version.h>

namespace craftfleet {

// Until destruction no thread of this process, or only this one, can allocate a tensor on the CPU: LibTorch throws
// std::bad_alloc.
class NoTensorMemory {
 public:
  NoTensorMemory() { c10::SetCPUAllocator(&none_); }
  // The other threads can, and this one `allocations` times more.
  explicit NoTensorMemory(int allocations) {
    none_.usual = usual_;
    none_.thread = std::this_thread::get_id();
    none_.left = allocations;
    c10::SetCPUAllocator(&none_);
  }
  ~NoTensorMemory() { c10::SetCPUAllocator(usual_); }
  NoTensorMemory(const NoTensorMemory&) = delete;
  NoTensorMemory& operator=(const NoTensorMemory&) = delete;

 private:
  struct None : c10::Allocator {
    c10::Allocator* usual = nullptr;  // of other threads; null: they have none either
    std::thread::id thread;
    mutable int left = 0;

    c10::DeleterFnPtr raw_deleter() const override { return usual == nullptr ? nullptr : usual->raw_deleter(); }

    c10::DataPtr Give(size_t bytes) const {
      const bool gives = usual != nullptr && (std::this_thread::get_id() != thread || left-- > 0);
      return gives ? usual->allocate(bytes) : throw std::bad_alloc();
    }
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 3)
    c10::DataPtr allocate(size_t bytes) override { return Give(bytes); }
    void copy_data(void* to, const void* from, size_t bytes) const override { default_copy_data(to, from, bytes); }
#else
    c10::DataPtr allocate(size_t bytes) const override { return Give(bytes); }
#endif
  };

  // Never freed: when it is replaced, another thread may be about to ask it.
  static None& Make() {
    static auto* const all = new std::deque<None>;
    return all->emplace_back();
  }

  c10::Allocator* const usual_ = c10::GetCPUAllocator();
  None& none_ = Make();
};

}  // namespace craftfleet
