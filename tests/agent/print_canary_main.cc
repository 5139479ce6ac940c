// print_canary CPU [bf16]: prints the policy's canary of a process that is pinned to CPU (native, avx2 or avx512), for
// a run that multiplies in float32 or in bfloat16. Pins itself like a worker, by executing itself again.

#include <iostream>
#include <string>

#include "common/agent/canary.h"
#include "common/base/status_macros.h"
#include "common/process/cpu_pin.h"

namespace craftfleet {
namespace {

absl::StatusOr<std::string> CanaryOn(const std::string& name, bool in_bf16) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::RunConfig::Cpu cpu, ParseCpu(name));
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(cpu));
  v1::RunConfig run;
  if (in_bf16) run.set_precision(v1::RunConfig::BF16);
  return PolicyCanary(run);
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const absl::StatusOr<std::string> canary = craftfleet::CanaryOn(argc > 1 ? argv[1] : "", argc > 2);
  (canary.ok() ? std::cout << *canary : std::cout << "error: " << canary.status().message()) << '\n';
  return canary.ok() ? 0 : 1;
}
