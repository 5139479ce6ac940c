// A checkpoint's files: refused, or with a consistent state. The first byte selects the file that is changed; the
// manifest's checksums are correct otherwise, so that the search gets past them.

#include "common/base/check.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/checkpoint.h"
#include "tests/fuzz/fuzz_folder.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

Checkpoint SoundCheckpoint() {
  v1::RunConfig config;
  config.set_agent("ppo_cnn");
  config.set_lanes(2);
  Checkpoint checkpoint;
  checkpoint.weights = std::make_shared<const std::string>("weights");
  checkpoint.optimizer = "optimizer";
  v1::CheckpointState& state = checkpoint.state;
  *state.mutable_config() = *ResolveRunConfig(config);
  state.set_program_version("0.2.0");
  state.set_run_id("20231114-221320-abcdef");
  state.set_iteration(3);
  state.set_env_steps(12288);
  for (int lane = 0; lane < 2; ++lane) state.add_lanes()->set_snapshot("a game");
  return checkpoint;
}

}  // namespace

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const std::string folder = JoinPath(FuzzFolder(), "checkpoint");
  Checkpoint checkpoint = SoundCheckpoint();
  const absl::string_view rest = input.substr(1);
  const bool state_changes = (input[0] & 1) == 0;
  if (state_changes && !checkpoint.state.ParseFromArray(rest.data(), static_cast<int>(rest.size()))) return;
  checkpoint.state.clear_pending();  // this checkpoint lacks the weights of pending evaluations
  CRAFTFLEET_CHECK(WriteCheckpointFiles(folder, checkpoint).ok());
  if (!state_changes) CRAFTFLEET_CHECK(WriteFileSynced(JoinPath(folder, "MANIFEST"), rest).ok());
  const auto loaded = LoadCheckpoint(folder, "");
  if (!loaded.ok()) return;
  CRAFTFLEET_CHECK(ValidateRunConfig(loaded->state.config()).ok());
  CRAFTFLEET_CHECK(loaded->state.lanes_size() == loaded->state.config().lanes());
  CRAFTFLEET_CHECK(loaded->state.iteration() >= 0 && loaded->state.env_steps() >= 0);
}

std::vector<std::string> SoundInputs() {
  const Checkpoint checkpoint = SoundCheckpoint();
  const std::string folder = JoinPath(FuzzFolder(), "sound");
  CRAFTFLEET_CHECK(WriteCheckpointFiles(folder, checkpoint).ok());
  return {std::string(1, '\0') + checkpoint.state.SerializeAsString(),
          std::string(1, '\1') + ReadFile(JoinPath(folder, "MANIFEST")).value()};
}

}  // namespace craftfleet
