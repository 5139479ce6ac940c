#include "common/agent/nets/map_tensors.h"

#include <cstdint>
#include <memory>

#include <ATen/ATen.h>
#include <c10/util/accumulate.h>

#include "common/agent/pooled_buffer.h"

namespace craftfleet {

at::Tensor PooledTensor(at::IntArrayRef shape) {
  const auto buffer = std::make_shared<PooledBuffer>(c10::multiply_integers(shape));
  return at::from_blob(buffer->get(), shape, [buffer](void*) {});
}

at::Tensor RoundedTensor(at::IntArrayRef shape) { return PooledTensor({shape[0], shape[1] / 2}).view(at::kBFloat16); }

at::Tensor PixelsOf(const at::Tensor& map) {
  const at::Tensor pixels = map.permute({0, 2, 3, 1}).contiguous();
  return reinterpret_cast<uintptr_t>(pixels.data_ptr()) % 64 == 0 ? pixels : pixels.clone();
}

at::Tensor MapOf(const at::Tensor& pixels) { return pixels.permute({0, 3, 1, 2}); }

float* DataOf(const at::Tensor& tensor) { return tensor.defined() ? tensor.data_ptr<float>() : nullptr; }

}  // namespace craftfleet
