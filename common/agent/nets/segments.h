// The inputs of a network besides frames, and its outputs.

#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <ATen/core/Tensor.h>

namespace craftfleet {

// LibTorch's packed sequence of k segments with N rows: the longest segment first, all first steps, then all second
// steps and so on.
struct Packing {
  at::Tensor rows;                   // int64[N] the input row of each packed row
  at::Tensor inverse_rows;           // int64[N] the packed row of each input row
  at::Tensor segments;               // int64[k] by descending length
  at::Tensor inverse_segments;       // int64[k] the place of each segment among them
  std::vector<int64_t> batch_sizes;  // [longest] segments that have a step t
};

// Of segments with these `lengths`, with tensors on the CPU.
Packing Pack(const std::vector<int>& lengths);

// The rows of a recurrent agent's input: k segments of consecutive steps, one after the other. With a memory, each row
// has its own state.
struct Segments {
  std::vector<int> lengths;  // [k] rows of each, at least 1; their sum is the number of rows; not needed with a memory
  at::Tensor states;         // float[k,state_size] before each; no gradient flows into it
  // For distillation: float[N,17], 1 at each row's action, else 0; if defined, NetOutput has predictions.
  at::Tensor actions = {};
  // Pack(lengths) on the device of the rows; absent, on the CPU only: made in each pass.
  std::optional<Packing> packing = std::nullopt;
};

struct NetOutput {
  at::Tensor logits;  // float[N,17]
  at::Tensor values;  // float[N]
  // float[k,state_size] after each segment, a memory as it was; undefined for agents without state.
  at::Tensor states = {};
  at::Tensor codes = {};        // float[N,F] features of feed-forward agents
  at::Tensor predictions = {};  // float[N,F] of the goal predictor, only on request
};

}  // namespace craftfleet
