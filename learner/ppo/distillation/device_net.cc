#include "learner/ppo/distillation/device_net.h"

#include <algorithm>
#include <exception>
#include <optional>
#include <utility>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/device.h"
#include "common/agent/policy_net.h"
#include "learner/ppo/device_rollout.h"

namespace craftfleet {
namespace {

constexpr size_t kRowsAtOnce = 512;    // without gradients
constexpr int64_t kSentAtOnce = 4096;  // rows of pinned memory

absl::Status Failure(const std::exception& error) { return DeviceError("distillation", error.what()); }

// Sends float[rows,width] or uint8, a row at a time from `row_of`; null: zeros.
template <typename Value, typename RowOf>
at::Tensor SendTable(int64_t rows, int64_t width, at::ScalarType type, at::Device device, const RowOf& row_of) {
  at::Tensor there = at::empty({rows, width}, at::TensorOptions(type).device(device));
  for (int64_t first = 0; first < rows; first += kSentAtOnce) {
    const int64_t count = std::min(kSentAtOnce, rows - first);
    const at::Tensor host = HostTensor({count, width}, type, device);
    auto* out = host.data_ptr<Value>();
    for (int64_t row = first; row < first + count; ++row) {
      const Value* const values = row_of(static_cast<int>(row));
      out = values == nullptr ? std::fill_n(out, width, Value{0}) : std::copy_n(values, width, out);
    }
    there.narrow(0, first, count).copy_(host, /*non_blocking=*/true);
  }
  return there;
}

// Copies columns of float[n,width] between a table on the host and NetNumbers.
class Columns {
 public:
  explicit Columns(const at::Tensor& table) : data_(table.data_ptr<float>()), width_(table.size(1)) {}

  void CopyTo(int64_t count, std::vector<float>* all) {
    auto out = all->begin();
    for (int64_t row = 0; out != all->end(); ++row) out = std::copy_n(data_ + row * width_ + next_, count, out);
    next_ += count;
  }
  void CopyFrom(int64_t count, const std::vector<float>& all) {
    auto in = all.begin();
    for (int64_t row = 0; in != all.end(); ++row, in += count) std::copy_n(in, count, data_ + row * width_ + next_);
    next_ += count;
  }

 private:
  float* const data_;
  const int64_t width_;
  int64_t next_ = 0;
};

}  // namespace

DeviceNet::DeviceNet(const AgentSpec& spec, at::Device device, DeviceWeights* weights, DeviceAdam* matching,
                     DeviceAdam* prediction)
    : spec_(spec),
      device_(device),
      network_(MakeNetwork(spec_.network)),
      code_size_(CodeSizeOf(spec)),
      weights_(weights),
      matching_(matching),
      prediction_(prediction) {}

absl::Status DeviceNet::Begin(const KeptRollouts* rollouts) {
  const int64_t rows = rollouts->rows();
  try {
    const auto frame_of = [&](int row) { return rollouts->frame(row); };
    frames_ = SendTable<uint8_t>(rows, spec_.frame_bytes(), at::kByte, device_, frame_of)
                  .view({rows, spec_.frame_size, spec_.frame_size, 3});
    const auto memory_of = [&](int row) { return rollouts->memory(row); };
    memories_ = SendTable<float>(rows, spec_.state_size, at::kFloat, device_, memory_of);
    std::vector<float> chosen(kNumActions);
    const auto action_of = [&](int row) {
      std::fill(chosen.begin(), chosen.end(), 0.0F);
      chosen[static_cast<size_t>(rollouts->action(row))] = 1;
      return chosen.data();
    };
    actions_ = SendTable<float>(rows, kNumActions, at::kFloat, device_, action_of);
  } catch (const std::exception& error) {
    return Failure(error);
  }
  return absl::OkStatus();
}

void DeviceNet::End() {
  for (at::Tensor* tensor : {&frames_, &memories_, &actions_}) *tensor = at::Tensor();
  output_ = NetOutput();
}

at::Tensor DeviceNet::SendRows(absl::Span<const int> rows) const {
  const at::Tensor host = HostTensor({static_cast<int64_t>(rows.size())}, at::kLong, device_);
  std::copy(rows.begin(), rows.end(), host.data_ptr<int64_t>());
  return host.to(device_, /*non_blocking=*/true);
}

at::Tensor DeviceNet::Frames(const at::Tensor& rows) const { return ScaleFrames(frames_.index_select(0, rows)); }

at::Tensor DeviceNet::Fetch(const at::Tensor& outputs) const {
  at::Tensor host = HostTensor(outputs.sizes(), at::kFloat, device_);
  host.copy_(outputs);
  return host;
}

template <typename Compute>
absl::StatusOr<std::vector<float>> DeviceNet::ComputeAll(absl::Span<const int> rows, const Compute& compute) const {
  std::vector<float> all;
  try {
    const c10::NoGradGuard no_grad;
    for (size_t done = 0; done < rows.size(); done += kRowsAtOnce) {
      const at::Tensor some = Fetch(compute(SendRows(rows.subspan(done, kRowsAtOnce))));
      all.insert(all.end(), some.data_ptr<float>(), some.data_ptr<float>() + some.numel());
    }
  } catch (const std::exception& error) {
    return Failure(error);
  }
  return all;
}

absl::StatusOr<std::vector<float>> DeviceNet::Codes(absl::Span<const int> rows) {
  return ComputeAll(
      rows, [this](const at::Tensor& some) { return network_.Features(weights_->params, Frames(some), std::nullopt); });
}

absl::StatusOr<std::vector<float>> DeviceNet::Logits(absl::Span<const int> rows) {
  return ComputeAll(rows, [this](const at::Tensor& some) {
    const Segments inputs{{}, memories_.index_select(0, some)};
    return network_.Forward(weights_->params, Frames(some), inputs, std::nullopt).logits;
  });
}

absl::StatusOr<NetNumbers> DeviceNet::Forward(absl::Span<const int> rows, bool predicts) {
  NetNumbers outputs(rows.size(), code_size_, predicts);
  try {
    const at::Tensor there = SendRows(rows);
    Segments inputs{{}, memories_.index_select(0, there)};
    inputs.wants_codes = true;
    if (predicts) inputs.actions = actions_.index_select(0, there);
    output_ = network_.Forward(weights_->params, Frames(there), inputs, std::nullopt);
    std::vector<at::Tensor> tensors = {output_.logits, output_.values.unsqueeze(1), output_.codes};
    if (predicts) tensors.push_back(output_.predictions);
    const at::Tensor fetched = Fetch(at::cat(tensors, 1).detach());
    Columns columns(fetched);
    columns.CopyTo(kNumActions, &outputs.logits);
    columns.CopyTo(1, &outputs.values);
    columns.CopyTo(code_size_, &outputs.codes);
    if (predicts) columns.CopyTo(code_size_, &outputs.predictions);
  } catch (const std::exception& error) {
    return Failure(error);
  }
  return outputs;
}

absl::StatusOr<double> DeviceNet::Step(const NetNumbers& gradients, DistillationLoss loss) {
  const bool predicts = !gradients.predictions.empty();
  const auto rows = static_cast<int64_t>(gradients.values.size());
  try {
    const NetOutput output = std::exchange(output_, {});
    const at::Tensor host = HostTensor({rows, kNumActions + 1 + code_size_}, at::kFloat, device_);
    Columns columns(host);
    columns.CopyFrom(kNumActions, gradients.logits);
    columns.CopyFrom(1, gradients.values);
    columns.CopyFrom(code_size_, predicts ? gradients.predictions : gradients.codes);
    const at::Tensor there = host.to(device_, /*non_blocking=*/true);
    torch::autograd::backward(
        {output.logits, output.values, predicts ? output.predictions : output.codes},
        {there.narrow(1, 0, kNumActions), there.select(1, kNumActions), there.narrow(1, kNumActions + 1, code_size_)});
    DeviceAdam* const adam = loss == DistillationLoss::kMatching ? matching_ : prediction_;
    return adam->Step(weights_->TakeGradient(), weights_->flat).cpu().item<double>();
  } catch (const std::exception& error) {
    return Failure(error);
  }
}

}  // namespace craftfleet
