// One version of an agent's weights, in whichever memory it is. Does not include LibTorch.

#pragma once

#include <memory>
#include <string>
#include <utility>

#include <absl/status/statusor.h>

namespace craftfleet {

// Never changes. Thread-safe.
class PolicyWeights {
 public:
  virtual ~PolicyWeights() = default;
  PolicyWeights(const PolicyWeights&) = delete;
  PolicyWeights& operator=(const PolicyWeights&) = delete;

  // Safetensors (common/agent/weights.h), for files and for other processes.
  //   As DeviceError (common/agent/device.h): the device failed on which they are.
  virtual absl::StatusOr<std::shared_ptr<const std::string>> Bytes() const = 0;

 protected:
  PolicyWeights() = default;
};

// Weights that are bytes already.
class HostWeights final : public PolicyWeights {
 public:
  explicit HostWeights(std::shared_ptr<const std::string> bytes) : bytes_(std::move(bytes)) {}
  explicit HostWeights(std::string bytes) : HostWeights(std::make_shared<const std::string>(std::move(bytes))) {}

  absl::StatusOr<std::shared_ptr<const std::string>> Bytes() const override { return bytes_; }

 private:
  const std::shared_ptr<const std::string> bytes_;
};

}  // namespace craftfleet
