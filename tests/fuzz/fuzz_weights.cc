// Weights as bytes: refused, or tensors that survive being written and read again.

#include "common/agent/agent_spec.h"
#include "common/agent/safetensors.h"
#include "common/base/check.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {

void TryInput(absl::string_view input) {
  const auto file = ReadSafetensors(input);
  if (!file.ok()) return;
  const std::string bytes = WriteSafetensors(*file);
  const auto again = ReadSafetensors(bytes);
  CRAFTFLEET_CHECK(again.ok() && again->tensors.size() == file->tensors.size());
  for (size_t i = 0; i < file->tensors.size(); ++i) {
    CRAFTFLEET_CHECK(again->tensors[i].name == file->tensors[i].name);
    CRAFTFLEET_CHECK(again->tensors[i].data == file->tensors[i].data);
  }
}

std::vector<std::string> SoundInputs() {
  const std::string data(4 * 6, '\x3f');
  SafeTensors file{{{"action_net.weight", {2, 2}, absl::string_view(data).substr(0, 16)},
                    {"action_net.bias", {2}, absl::string_view(data).substr(16)}},
                   {{"steps", "7"}}};
  return {WriteSafetensors(file), WriteSafetensors({})};
}

}  // namespace craftfleet
