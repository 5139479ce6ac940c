// The part of a recurrent agent between features and heads. Does not include LibTorch.

#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "common/agent/nets/layers.h"

namespace craftfleet {

struct Packing;
struct Segments;

// An LSTM of 256: `name`.weight_ih_l0, .weight_hh_l0, .bias_ih_l0, .bias_hh_l0, gates in the order i, f, g, o.
class LstmLayer {
 public:
  static constexpr int64_t kHidden = 256;
  static constexpr int64_t kStateSize = 2 * kHidden;  // h, then c

  LstmLayer(const std::string& name, int64_t inputs, ParamList* params);

  // features float[N,inputs], states float[k,kStateSize] -> float[N,kHidden]; `last_states` float[k,kStateSize].
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& features, const Packing& packing,
                     const at::Tensor& states, at::Tensor* last_states) const;

 private:
  ParamIndex weight_ih_, weight_hh_, bias_ih_, bias_hh_;
};

// The actor's LSTM, "lstm_actor", and beside it for the critic either a linear layer without activation, "critic", or
// an LSTM of its own, "lstm_critic". Immutable and thread-safe.
// Source: Stanic et al. 2022; AGENTS.md, section 6.
class RecurrentCore {
 public:
  enum class Critic { kLinear, kLstm };

  RecurrentCore(int64_t inputs, Critic critic, ParamList* params);

  int64_t state_size() const { return LstmLayer::kStateSize * (lstm_critic_.has_value() ? 2 : 1); }

  // From features float[N,inputs]: float[N,256] each; `last_states` float[k,state_size], the actor's before the
  // critic's.
  void Forward(const ParamTensors& params, const at::Tensor& features, const Segments& segments,
               at::Tensor* actor_features, at::Tensor* critic_features, at::Tensor* last_states) const;

 private:
  LstmLayer lstm_actor_;
  std::optional<LstmLayer> lstm_critic_;  // one of these two
  std::optional<LinearLayer> critic_;
};

}  // namespace craftfleet
