// The network as distillation computes with it: on the CPU in shards, or on a device. Does not include LibTorch.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_NET_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_NET_H_

#include <cstddef>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/base/crafter.h"
#include "learner/ppo/distillation/kept_rollouts.h"

namespace craftfleet {

// Of n rows: the network's outputs, or gradients by them.
struct NetNumbers {
  // `predicts`: with predictions.
  NetNumbers(size_t rows, int code_size, bool predicts)
      : logits(rows * kNumActions),
        values(rows),
        codes(rows * code_size),
        predictions(predicts ? rows * code_size : 0),
        width(code_size) {}

  const float* code(int row) const { return &codes[static_cast<size_t>(row) * width]; }
  float* code(int row) { return &codes[static_cast<size_t>(row) * width]; }
  const float* prediction(int row) const { return &predictions[static_cast<size_t>(row) * width]; }
  float* prediction(int row) { return &predictions[static_cast<size_t>(row) * width]; }

  std::vector<float> logits;       // [n,17]
  std::vector<float> values;       // [n]
  std::vector<float> codes;        // [n,width] features
  std::vector<float> predictions;  // [n,width] of the goal predictor, or empty
  int width;
};

// The two losses, each with its own optimiser.
enum class DistillationLoss { kMatching, kPrediction };

// Owned by one thread. Its functions return Internal if LibTorch failed, on a GPU errors as DeviceError
// (common/agent/device.h).
class DistillationNet {
 public:
  virtual ~DistillationNet() = default;

  // Rows are those of `rollouts`, which stay as they are until End.
  virtual absl::Status Begin(const KeptRollouts* rollouts) = 0;
  virtual void End() = 0;

  // float[rows,F] features of rows, without gradients.
  virtual absl::StatusOr<std::vector<float>> Codes(absl::Span<const int> rows) = 0;
  // float[rows,17] logits of rows, likewise.
  virtual absl::StatusOr<std::vector<float>> Logits(absl::Span<const int> rows) = 0;

  // The outputs for `rows`, which are distinct; Step must follow.
  virtual absl::StatusOr<NetNumbers> Forward(absl::Span<const int> rows, bool predicts) = 0;
  // Takes a step of the optimiser of `loss`, with the gradients by the last Forward's outputs. Returns the L2 norm of
  // the weights' gradient before clipping. Predictions, if there are any, do not train the features that are to be
  // predicted: then `gradients.codes` is ignored.
  virtual absl::StatusOr<double> Step(const NetNumbers& gradients, DistillationLoss loss) = 0;
};

// The size of an agent's features (F).
int CodeSizeOf(const AgentSpec& spec);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_NET_H_
