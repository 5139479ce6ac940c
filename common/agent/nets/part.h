// One part of a network between frames and features. Does not include LibTorch.

#pragma once

#include <cstdint>
#include <optional>

#include <ATen/core/ATen_fwd.h>

namespace craftfleet {

struct ParamTensors;
struct Preparation;

// The dropout of attention weights in a forward pass of training: a function of (key, row, index), independent of
// threads.
struct Dropout {
  uint64_t key = 0;       // of the minibatch
  int64_t first_row = 0;  // the minibatch's row that is row 0 of this pass
};

// Parts follow each other: the output of one is the input of the next. A map is float[N,C,H,W], channels last in
// memory; features are float[N,F].
// A part's constructor adds its parameters to a ParamList. Immutable and thread-safe.
class Part {
 public:
  virtual ~Part() = default;

  // `dropout`: given in training alone.
  virtual at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                             const std::optional<Dropout>& dropout) const = 0;

  // Adds what the part computes from its weights alone (prepared_weights.h).
  virtual void Prepare(const ParamTensors& /*params*/, Preparation* /*preparation*/) const {}
};

// A part that attends to patches of its map and can report its attention.
class AttentionPart : public Part {
 public:
  // The map of Forward -> float[N,views,patches]: how much each of its views (OC-SA: heads of the CLS token, OC-CA:
  // slots) attends to each patch, patches in the order of CutPatches. As in acting: nothing is dropped.
  virtual at::Tensor Attention(const ParamTensors& params, const at::Tensor& input) const = 0;
};

}  // namespace craftfleet
