// What goes into a network beside frames, and what comes out.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_SEGMENTS_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_SEGMENTS_H_

#include <vector>

#include <ATen/core/Tensor.h>

namespace craftfleet {

// How the rows of a recurrent agent's input follow each other: k runs of consecutive steps, one after the other.
struct Segments {
  std::vector<int> lengths;  // [k] rows of each, at least 1; their sum is the number of rows
  at::Tensor states;         // float[k,state_size] before each; no gradient flows into it
};

struct NetOutput {
  at::Tensor logits;  // float[N,17]
  at::Tensor values;  // float[N]
  at::Tensor states;  // float[k,state_size] after each segment; undefined for feed-forward agents
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_SEGMENTS_H_
