#include "tests/agent/stand_in_device.h"

#include <atomic>
#include <exception>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <ATen/core/LegacyTypeDispatch.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <absl/base/const_init.h>
#include <absl/base/thread_annotations.h>
#include <absl/strings/match.h>
#include <absl/strings/string_view.h>
#include <absl/synchronization/mutex.h>
#include <c10/core/DeviceType.h>
#include <c10/core/InferenceMode.h>
#include <c10/core/impl/DeviceGuardImplInterface.h>
#include <torch/library.h>
#include <torch/version.h>

#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 11)
#include <ATen/DeviceAccelerator.h>
#include <ATen/detail/PrivateUse1HooksInterface.h>
#define CRAFTFLEET_HAS_ACCELERATORS_
#endif

namespace craftfleet {
namespace {

std::atomic<int64_t> sent{0};
std::atomic<int64_t> fetched{0};
std::atomic<int64_t> read{0};
std::atomic<int64_t> computed{0};
std::atomic<int64_t> awaited{0};
std::atomic<int64_t> called{0};
std::atomic<int64_t> last_called{-1};  // the call that finds no memory

absl::Mutex observer_mutex(absl::kConstInit);
ComputationObserver& Observer() ABSL_EXCLUSIVE_LOCKS_REQUIRED(observer_mutex) {
  static auto* const observer = new ComputationObserver;
  return *observer;
}

// Counts a computation that is done.
void Computed(absl::string_view name, const std::vector<c10::IValue>& arguments,
              const std::vector<at::Tensor>& results) {
  ++computed;
  const absl::MutexLock lock(&observer_mutex);
  if (Observer()) Observer()(name, arguments, results);
}

const c10::Device our_device(c10::DeviceType::PrivateUse1, 0);

bool IsOurs(const at::Tensor& tensor) { return tensor.device().type() == c10::DeviceType::PrivateUse1; }

// The same memory as a tensor of another device.
at::Tensor SeenFrom(c10::Device device, c10::DispatchKey key, const at::Tensor& tensor) {
  auto* const owner = new c10::Storage(tensor.storage());
  c10::DataPtr memory(
      owner->data_ptr().get(), owner, [](void* kept) { delete static_cast<c10::Storage*>(kept); }, device);
  c10::Storage storage(c10::make_intrusive<c10::StorageImpl>(c10::StorageImpl::use_byte_size_t(), owner->nbytes(),
                                                             std::move(memory), nullptr, /*resizable=*/false));
  at::Tensor seen =
      at::detail::make_tensor<c10::TensorImpl>(std::move(storage), c10::DispatchKeySet(key), tensor.dtype());
  seen.unsafeGetTensorImpl()->set_sizes_and_strides(tensor.sizes(), tensor.strides());
  seen.unsafeGetTensorImpl()->set_storage_offset(tensor.storage_offset());
  return seen;
}

at::Tensor OnHost(const at::Tensor& ours) { return SeenFrom(c10::Device(c10::kCPU), c10::DispatchKey::CPU, ours); }
at::Tensor Ours(const at::Tensor& host) { return SeenFrom(our_device, c10::DispatchKey::PrivateUse1, host); }

// A tensor given to the computation `name`. Like a GPU's, it accepts a tensor of the CPU only if that is one number.
at::Tensor Argument(const at::Tensor& tensor, const std::string& name) {
  if (!tensor.defined()) return tensor;
  if (IsOurs(tensor)) return OnHost(tensor);
  if (tensor.dim() == 0) return tensor;
  throw std::runtime_error(name + ": a tensor is on the CPU, want all on the device");
}

void ReplaceArgument(const std::string& name, c10::IValue* value) {
  if (value->isTensor()) {
    *value = Argument(value->toTensor(), name);
  } else if (value->isTensorList()) {
    std::vector<at::Tensor> tensors;
    for (const at::Tensor& tensor : value->toTensorVector()) tensors.push_back(Argument(tensor, name));
    *value = c10::IValue(tensors);
  } else if (value->isDevice()) {
    *value = c10::IValue(c10::Device(c10::kCPU));
  }
}

// The argument whose memory the computation's result number `result` shares, by its schema; -1: none.
int SharedArgument(const c10::FunctionSchema& schema, size_t result) {
  const auto* const alias = schema.returns()[result].alias_info();
  for (size_t i = 0; alias != nullptr && i < schema.arguments().size(); ++i) {
    const auto* const other = schema.arguments()[i].alias_info();
    if (other != nullptr && other->beforeSets() == alias->beforeSets()) return static_cast<int>(i);
  }
  return -1;
}

// Whether a call makes a view or takes memory, for which a GPU runs nothing.
bool OnlyDescribes(const c10::FunctionSchema& schema) {
  if (absl::StartsWith(schema.name(), "aten::empty")) return true;
  const auto* const alias = schema.returns().empty() ? nullptr : schema.returns()[0].alias_info();
  return alias != nullptr && !alias->isWrite();
}

// Any computation of the device: that of the CPU, on the same memory.
void Compute(const c10::OperatorHandle& op, torch::jit::Stack* stack) {
  const c10::FunctionSchema& schema = op.schema();
  const std::string& name = schema.name();
  if (++called == last_called) {
    throw std::runtime_error("CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a total capacity of 7.79 GiB");
  }
  const size_t begin = stack->size() - schema.arguments().size();
  const std::vector<c10::IValue> arguments(stack->begin() + begin, stack->end());
  for (size_t i = begin; i < stack->size(); ++i) ReplaceArgument(name, &(*stack)[i]);
  {
    const at::AutoDispatchBelowADInplaceOrView guard;
    try {
      op.callBoxed(stack);
    } catch (const std::exception& error) {
      throw std::runtime_error(name + " on the stand-in device: " + error.what());
    }
  }
  const size_t first = stack->size() - schema.returns().size();
  std::vector<at::Tensor> results;
  for (size_t i = 0; i < schema.returns().size(); ++i) {
    c10::IValue& result = (*stack)[first + i];
    const int shared = SharedArgument(schema, i);
    if (shared >= 0 && schema.returns()[i].alias_info()->isWrite()) {
      result = arguments[shared];
    } else if (shared >= 0 && result.isTensor()) {
      // A view of a tensor from outside of inference mode is one like that too.
      const c10::InferenceMode mode(arguments[shared].toTensor().is_inference());
      result = Ours(result.toTensor());
    } else if (result.isTensor() && result.toTensor().defined()) {
      result = Ours(result.toTensor());
    } else if (result.isTensorList()) {
      std::vector<at::Tensor> tensors;
      for (const at::Tensor& tensor : result.toTensorVector()) tensors.push_back(Ours(tensor));
      result = c10::IValue(tensors);
    } else if (!result.isTensor()) {
      ++read;
    }
    if (result.isTensor()) results.push_back(result.toTensor());
  }
  if (!OnlyDescribes(schema)) Computed(name, arguments, results);
}

at::Tensor CopyFrom(const at::Tensor& from, const at::Tensor& to, bool /*non_blocking*/) {
  at::Tensor there = IsOurs(to) ? OnHost(to) : to;
  there.copy_(IsOurs(from) ? OnHost(from) : from);
  if (!IsOurs(from)) {
    ++sent;
  } else if (!IsOurs(to)) {
    ++fetched;
  } else {
    Computed("aten::copy_", {from}, {to});
  }
  return to;
}

// Max pooling, whose two outputs LibTorch boxes in a way to which UndefinedBehaviorSanitizer objects.
std::tuple<at::Tensor, at::Tensor> MaxPool(const at::Tensor& input, at::IntArrayRef kernel, at::IntArrayRef stride,
                                           at::IntArrayRef padding, at::IntArrayRef dilation, bool ceil_mode) {
  const at::Tensor host = Argument(input, "max_pool2d");
  const at::AutoDispatchBelowADInplaceOrView guard;
  const auto [output, indices] = at::max_pool2d_with_indices(host, kernel, stride, padding, dilation, ceil_mode);
  Computed("aten::max_pool2d_with_indices", {input}, {output, indices});
  return {Ours(output), Ours(indices)};
}

at::Tensor MaxPoolBackward(const at::Tensor& by_output, const at::Tensor& input, at::IntArrayRef kernel,
                           at::IntArrayRef stride, at::IntArrayRef padding, at::IntArrayRef dilation, bool ceil_mode,
                           const at::Tensor& indices) {
  const std::string name = "max_pool2d_backward";
  const at::AutoDispatchBelowADInplaceOrView guard;
  const at::Tensor by_input =
      at::max_pool2d_with_indices_backward(Argument(by_output, name), Argument(input, name), kernel, stride, padding,
                                           dilation, ceil_mode, Argument(indices, name));
  Computed("aten::max_pool2d_with_indices_backward", {by_output, indices}, {by_input});
  return Ours(by_input);
}

// The cell of an LSTM, for which LibTorch 2 takes this computation on devices; the CPU lacks it. The third result is
// for the backward pass.
std::tuple<at::Tensor, at::Tensor, at::Tensor> LstmCell(const at::Tensor& input_gates, const at::Tensor& hidden_gates,
                                                        const at::Tensor& cell,
                                                        const c10::optional<at::Tensor>& input_bias,
                                                        const c10::optional<at::Tensor>& hidden_bias) {
  const std::string name = "lstm_cell";
  const at::AutoDispatchBelowADInplaceOrView guard;
  at::Tensor all = Argument(input_gates, name) + Argument(hidden_gates, name);
  for (const auto* bias : {&input_bias, &hidden_bias}) {
    if (bias->has_value() && (*bias)->defined()) all = all + Argument(**bias, name);
  }
  const std::vector<at::Tensor> gates = at::chunk(all, 4, 1);
  const at::Tensor next = at::sigmoid(gates[1]) * Argument(cell, name) + at::sigmoid(gates[0]) * at::tanh(gates[2]);
  const at::Tensor hidden = at::sigmoid(gates[3]) * at::tanh(next);
  Computed("aten::_thnn_fused_lstm_cell", {input_gates, hidden_gates, cell}, {hidden, next, all});
  return {Ours(hidden), Ours(next), Ours(all)};
}

// The gradients of the gates, of the cell before and of the biases.
std::tuple<at::Tensor, at::Tensor, at::Tensor> LstmCellBackward(const c10::optional<at::Tensor>& by_hidden,
                                                                const c10::optional<at::Tensor>& by_next,
                                                                const at::Tensor& cell, const at::Tensor& next,
                                                                const at::Tensor& all, bool has_bias) {
  const std::string name = "lstm_cell_backward";
  const at::AutoDispatchBelowADInplaceOrView guard;
  const std::vector<at::Tensor> gates = at::chunk(Argument(all, name), 4, 1);
  const at::Tensor in = at::sigmoid(gates[0]);
  const at::Tensor forget = at::sigmoid(gates[1]);
  const at::Tensor value = at::tanh(gates[2]);
  const at::Tensor out = at::sigmoid(gates[3]);
  const at::Tensor shown = at::tanh(Argument(next, name));
  at::Tensor by_cell = at::zeros_like(shown);
  at::Tensor by_out = at::zeros_like(shown);
  if (by_hidden.has_value() && by_hidden->defined()) {
    by_cell = Argument(*by_hidden, name) * out * (1 - shown * shown);
    by_out = Argument(*by_hidden, name) * shown;
  }
  if (by_next.has_value() && by_next->defined()) by_cell = by_cell + Argument(*by_next, name);
  const at::Tensor by_gates =
      at::cat({by_cell * value * in * (1 - in), by_cell * Argument(cell, name) * forget * (1 - forget),
               by_cell * in * (1 - value * value), by_out * out * (1 - out)},
              1);
  Computed("aten::_thnn_fused_lstm_cell_backward_impl", {cell, next, all}, {by_gates, by_cell});
  return {Ours(by_gates), Ours(by_cell * forget), has_bias ? Ours(by_gates.sum(0)) : at::Tensor()};
}

TORCH_LIBRARY_IMPL(_, PrivateUse1, library) { library.fallback(torch::CppFunction::makeFromBoxedFunction<&Compute>()); }

TORCH_LIBRARY_IMPL(aten, PrivateUse1, library) {
  library.impl("_copy_from", &CopyFrom);
  library.impl("max_pool2d_with_indices", &MaxPool);
  library.impl("max_pool2d_with_indices_backward", &MaxPoolBackward);
  library.impl("_thnn_fused_lstm_cell", &LstmCell);
  library.impl("_thnn_fused_lstm_cell_backward_impl", &LstmCellBackward);
  // LibTorch would take these apart into computations that resize their output, which ours can't.
  for (const char* name :
       {"arange", "arange.start", "arange.start_step", "linspace", "convolution", "convolution_backward",
        "native_group_norm", "native_layer_norm", "stack", "cat", "abs", "logical_and"}) {
    library.impl(name, torch::CppFunction::makeFromBoxedFunction<&Compute>());
  }
}

thread_local c10::StreamId current_stream = 0;

// Gives autograd a thread for the device. Work of each stream is done when a call returns.
class DeviceGuard final : public c10::impl::DeviceGuardImplInterface {
 public:
  c10::DeviceType type() const override { return c10::DeviceType::PrivateUse1; }
  c10::DeviceIndex deviceCount() const noexcept override { return 1; }
  c10::Device getDevice() const override { return {type(), 0}; }
  c10::Device exchangeDevice(c10::Device /*device*/) const override { return getDevice(); }
  void setDevice(c10::Device /*device*/) const override {}
  void uncheckedSetDevice(c10::Device /*device*/) const noexcept override {}
  c10::Stream getStream(c10::Device device) const noexcept override {
    return c10::Stream(c10::Stream::UNSAFE, device, current_stream);
  }
  c10::Stream getDefaultStream(c10::Device device) const override { return c10::Stream(c10::Stream::DEFAULT, device); }
  c10::Stream getStreamFromGlobalPool(c10::Device device, bool /*is_high_priority*/) const override {
    return c10::Stream(c10::Stream::UNSAFE, device, kOtherStream);
  }
  c10::Stream exchangeStream(c10::Stream stream) const noexcept override {
    const c10::Stream before = getStream(stream.device());
    current_stream = stream.id();
    return before;
  }
  void record(void** event, const c10::Stream& stream, c10::DeviceIndex /*device*/,
              c10::EventFlag /*flag*/) const override {
    if (*event == nullptr) *event = new c10::StreamId;
    *static_cast<c10::StreamId*>(*event) = stream.id();
  }
  void block(void* event, const c10::Stream& stream) const override {
    if (*static_cast<c10::StreamId*>(event) != stream.id()) ++awaited;
  }
  void destroyEvent(void* event, c10::DeviceIndex /*device*/) const noexcept override {
    delete static_cast<c10::StreamId*>(event);
  }
  bool queryEvent(void* /*event*/) const override { return true; }
  bool queryStream(const c10::Stream& /*stream*/) const override { return true; }
  void synchronizeStream(const c10::Stream& /*stream*/) const override {}
};
C10_REGISTER_GUARD_IMPL(PrivateUse1, DeviceGuard)

#ifdef CRAFTFLEET_HAS_ACCELERATORS_
class Hooks final : public at::PrivateUse1HooksInterface {
 public:
  bool isBuilt() const override { return true; }
  bool isAvailable() const override { return true; }
  bool hasPrimaryContext(c10::DeviceIndex /*device*/) const override { return true; }
};

// A LibTorch with CUDA would ask the GPU's driver for the stream of every device, also where there is no GPU, until
// another device is its accelerator.
const bool is_accelerator = [] {
  if (!at::getAccelerator().has_value()) return false;
  c10::register_privateuse1_backend("privateuseone");
  at::RegisterPrivateUse1HooksInterface(new Hooks);
  return true;
}();
#endif

}  // namespace

void RunOutOfMemoryAfter(int64_t count) { last_called = called + count; }

void ObserveComputations(ComputationObserver observer) {
  const absl::MutexLock lock(&observer_mutex);
  Observer() = std::move(observer);
}

DeviceTraffic TrafficSoFar() { return {sent, fetched, read, computed, awaited}; }

}  // namespace craftfleet
