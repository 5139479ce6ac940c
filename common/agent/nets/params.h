// The parameters of a network: names, shapes, initialisation. Does not include LibTorch.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace craftfleet {

// The initialisation of a parameter.
struct ParamInit {
  enum class Kind {
    kConstant,    // `scale`
    kNormal,      // N(0, scale^2)
    kUniform,     // U(-scale, scale)
    kOrthogonal,  // [out, everything else] a uniformly drawn orthogonal matrix times `scale`
    kRowNorm,     // [out, everything else] uniform numbers, each row scaled to the L2 norm `scale`
  };
  Kind kind = Kind::kConstant;
  double scale = 0;
};

// One tensor of a network. All parameters of an agent are in one flat array, each row-major, in the spec's order.
struct ParamSpec {
  std::string name;            // "features_extractor.cnn.0.weight": also its name in saved weights
  std::vector<int64_t> shape;  // linear [out, in], convolution [out, in, k, k]
  int64_t offset = 0;          // of its first value in the flat array
  int64_t size = 0;            // values
  ParamInit init;
};

// A parameter's index in the list, with which the part that declared it finds it in ParamTensors.
using ParamIndex = int;
constexpr ParamIndex kNoParam = -1;

// The parameters of a network under construction: each part adds its own.
class ParamList {
 public:
  ParamIndex Add(std::string name, std::vector<int64_t> shape, ParamInit init);

  const std::vector<ParamSpec>& specs() const { return specs_; }
  int64_t count() const { return count_; }  // values, all parameters together

 private:
  std::vector<ParamSpec> specs_;
  int64_t count_ = 0;
};

}  // namespace craftfleet
