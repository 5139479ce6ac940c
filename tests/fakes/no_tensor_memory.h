// Makes LibTorch fail like on a machine without memory.

#ifndef CRAFTFLEET_TESTS_FAKES_NO_TENSOR_MEMORY_H_
#define CRAFTFLEET_TESTS_FAKES_NO_TENSOR_MEMORY_H_

#include <cstddef>
#include <new>

#include <c10/core/CPUAllocator.h>
#include <torch/version.h>

namespace craftfleet {

// Until destruction no thread of this process can allocate a tensor on the CPU: LibTorch throws std::bad_alloc.
class NoTensorMemory {
 public:
  NoTensorMemory() { c10::SetCPUAllocator(&none_); }
  ~NoTensorMemory() { c10::SetCPUAllocator(usual_); }
  NoTensorMemory(const NoTensorMemory&) = delete;
  NoTensorMemory& operator=(const NoTensorMemory&) = delete;

 private:
  class None : public c10::Allocator {
   public:
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 3)
    c10::DataPtr allocate(size_t) override { throw std::bad_alloc(); }
    void copy_data(void* to, const void* from, size_t bytes) const override { default_copy_data(to, from, bytes); }
#else
    c10::DataPtr allocate(size_t) const override { throw std::bad_alloc(); }
#endif
  };

  c10::Allocator* const usual_ = c10::GetCPUAllocator();
  None none_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_NO_TENSOR_MEMORY_H_
