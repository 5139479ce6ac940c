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
#include "common/base/crafter.h"
#include "common/base/status_macros.h"
#include "learner/ppo/device_rollout.h"
#include "learner/ppo/distillation/device_losses.h"

namespace craftfleet {
namespace {

constexpr int64_t kRowsAtOnce = 512;   // without gradients
constexpr int64_t kSentAtOnce = 4096;  // rows of pinned memory

absl::Status Failure(const std::exception& error) { return DistillingDeviceError("distillation", error.what()); }

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

}  // namespace

DeviceNet::DeviceNet(const AgentSpec& spec, at::Device device, DeviceWeights* weights, DeviceAdam* matching,
                     DeviceAdam* prediction)
    : spec_(spec),
      device_(device),
      network_(MakeNetwork(spec_.network)),
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
    for (at::Tensor* sums : {&matching_sums_, &prediction_sums_}) {
      *sums = at::zeros({4}, at::TensorOptions(at::kDouble).device(device_));
    }
  } catch (const std::exception& error) {
    return Failure(error);
  }
  return absl::OkStatus();
}

void DeviceNet::End() {
  for (at::Tensor* tensor :
       {&frames_, &memories_, &actions_, &old_log_probs_, &changes_, &matching_sums_, &prediction_sums_}) {
    *tensor = at::Tensor();
  }
}

at::Tensor DeviceNet::Frames(const at::Tensor& rows) const { return ScaleFrames(frames_.index_select(0, rows)); }

template <typename Compute>
at::Tensor DeviceNet::ComputeAll(absl::Span<const int> rows, const Compute& compute) const {
  const c10::NoGradGuard no_grad;
  const at::Tensor host = HostTensor({static_cast<int64_t>(rows.size())}, at::kLong, device_);
  std::copy(rows.begin(), rows.end(), host.data_ptr<int64_t>());
  std::vector<at::Tensor> parts;
  for (const at::Tensor& some : host.to(device_, /*non_blocking=*/true).split(kRowsAtOnce)) {
    parts.push_back(compute(some));
  }
  return at::cat(parts);
}

std::vector<float> DeviceNet::Fetch(const at::Tensor& table) const {
  const at::Tensor host = HostTensor(table.sizes(), at::kFloat, device_);
  host.copy_(table);
  return {host.data_ptr<float>(), host.data_ptr<float>() + host.numel()};
}

absl::StatusOr<std::vector<float>> DeviceNet::Logits(absl::Span<const int> rows) {
  try {
    return Fetch(ComputeAll(rows, [this](const at::Tensor& some) { return Forward(some, false).logits; }));
  } catch (const std::exception& error) {
    return Failure(error);
  }
}

absl::Status DeviceNet::SetOldLogits(std::vector<float> logits) {
  try {
    const auto logits_of = [&](int row) { return &logits[static_cast<size_t>(row) * kNumActions]; };
    const auto rows = static_cast<int64_t>(logits.size() / kNumActions);
    old_log_probs_ = SendTable<float>(rows, kNumActions, at::kFloat, device_, logits_of).to(at::kDouble).log_softmax(1);
  } catch (const std::exception& error) {
    return Failure(error);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<float>> DeviceNet::Changes(absl::Span<const FramePair> pairs) {
  std::vector<int> rows;
  for (const FramePair& pair : pairs) rows.push_back(pair.before);
  for (const FramePair& pair : pairs) rows.push_back(pair.after);
  try {
    const at::Tensor codes = ComputeAll(rows, [this](const at::Tensor& some) {
      return network_.Features(weights_->params, Frames(some), std::nullopt);
    });
    const auto count = static_cast<int64_t>(pairs.size());
    const at::Tensor differences = (codes.narrow(0, count, count) - codes.narrow(0, 0, count)).to(at::kDouble);
    const at::Tensor lengths = differences.square().sum(1, /*keepdim=*/true).sqrt().clamp_min(1e-12);
    changes_ = (differences / lengths).to(at::kFloat);
    return Fetch(changes_);
  } catch (const std::exception& error) {
    return Failure(error);
  }
}

NetOutput DeviceNet::Forward(const at::Tensor& rows, bool predicts) const {
  Segments inputs{{}, memories_.index_select(0, rows)};
  if (predicts) inputs.actions = actions_.index_select(0, rows);
  return network_.Forward(weights_->params, Frames(rows), inputs, std::nullopt);
}

absl::Status DeviceNet::Step(const DistillationStep& step) {
  const bool predicts = step.loss == DistillationLoss::kPrediction;
  try {
    const DeviceStep sent = SendStep(step, device_);
    const NetOutput output = Forward(sent.rows, predicts);
    const DeviceStepLosses losses =
        StepLossesOnDevice(sent, output, changes_, old_log_probs_.index_select(0, sent.rows));
    torch::autograd::backward({output.logits, output.values, predicts ? output.predictions : output.codes},
                              {losses.by_logits, losses.by_values, losses.by_features});
    const at::Tensor norm = (predicts ? prediction_ : matching_)->Step(weights_->TakeGradient(), weights_->flat);
    SumsOf(step.loss)->add_(at::cat({losses.means, norm.view({1})}));
  } catch (const std::exception& error) {
    return Failure(error);
  }
  return absl::OkStatus();
}

absl::StatusOr<DistillationLosses> DeviceNet::TakeLosses(DistillationLoss loss) {
  DistillationLosses losses;
  try {
    at::Tensor* const sums = SumsOf(loss);
    const at::Tensor fetched = std::exchange(*sums, at::zeros_like(*sums)).cpu();
    const auto* const fields = fetched.data_ptr<double>();
    losses = {fields[0], fields[1], fields[2], fields[3]};
  } catch (const std::exception& error) {
    return Failure(error);
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckNorm(losses.gradient_norm));
  return losses;
}

}  // namespace craftfleet
