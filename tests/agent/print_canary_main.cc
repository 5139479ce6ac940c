// print_canary CPU: prints the policy's canary of a process that is pinned to CPU (native, avx2 or avx512). Pins itself
// like a worker, by executing itself again.

#include <iostream>
#include <string>

#include "common/agent/canary.h"
#include "common/base/status_macros.h"
#include "common/process/cpu_pin.h"

namespace craftfleet {
namespace {

absl::StatusOr<std::string> CanaryOn(const std::string& name) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::RunConfig::Cpu cpu, ParseCpu(name));
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(cpu));
  return PolicyCanary();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const absl::StatusOr<std::string> canary = craftfleet::CanaryOn(argc > 1 ? argv[1] : "");
  (canary.ok() ? std::cout << *canary : std::cout << "error: " << canary.status().message()) << '\n';
  return canary.ok() ? 0 : 1;
}
