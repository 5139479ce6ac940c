// A run's configuration as text: if it is accepted, all values are in range and survive being written and read again.

#include "common/base/check.h"
#include "common/config/config.h"
#include "common/config/env_name.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {

void TryInput(absl::string_view input) {
  const auto parsed = ParseRunConfig(input, "input");
  if (!parsed.ok()) return;
  EnvName::Parse(parsed->env().name()).status().IgnoreError();
  const auto config = ResolveRunConfig(*parsed);
  if (!config.ok()) return;
  CRAFTFLEET_CHECK(ValidateRunConfig(*config).ok());
  const std::string text = FormatRunConfig(*config);
  const auto again = ParseRunConfig(text, "again");
  CRAFTFLEET_CHECK(again.ok() && FormatRunConfig(*ResolveRunConfig(*again)) == text);
}

std::vector<std::string> SoundInputs() {
  return {R"(agent: "ppo_cnn" seed: 3 lanes: 8 env { name: "crafter:numbers=easy-x2,inventory=off" length: 90 })",
          R"(agent: "oc_ca" network { slots: 4 heads: 2 patch: 8 stride: 8 } ppo { learning_rate: 1e-3 epochs: 3 })",
          R"(agent: "lstm_cnn" eval { env: "crafter" every_steps: 5000 } checkpoint { keep: 2 } # a comment)"};
}

}  // namespace craftfleet
