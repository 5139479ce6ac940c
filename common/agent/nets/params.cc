#include "common/agent/nets/params.h"

#include <utility>

namespace craftfleet {

ParamIndex ParamList::Add(std::string name, std::vector<int64_t> shape, ParamInit init) {
  ParamSpec param{std::move(name), std::move(shape), count_, 1, init};
  for (const int64_t length : param.shape) param.size *= length;
  count_ += param.size;
  specs_.push_back(std::move(param));
  return static_cast<ParamIndex>(specs_.size()) - 1;
}

}  // namespace craftfleet
