// Files that a user or a run folder has.

#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>

#include "common/base/check.h"
#include "common/config/config.h"
#include "common/config/env_name.h"
#include "common/io/files.h"
#include "learner/run/checkpoint.h"
#include "learner/run/stats_log.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

// A run's configuration as text: if it is accepted, all values are in range and survive being written and read again.
namespace config {

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

const FuzzTarget kTarget("config", TryInput, SoundInputs);

}  // namespace config

// stats.jsonl: an episode must not change when it is written and read again, except that the reward is rounded as by
// Crafter's recorder; writing it once more must give the same line.
namespace stats {

void TryLine(absl::string_view line) {
  const auto read = ParseStatsLine(line);
  if (!read.ok()) return;
  const std::string text = FormatStatsLine(*read);
  const auto again = ParseStatsLine(absl::StripSuffix(text, "\n"));
  CRAFTFLEET_CHECK(again.ok());
  CRAFTFLEET_CHECK(again->length == read->length);
  CRAFTFLEET_CHECK(again->achievements == read->achievements);
  CRAFTFLEET_CHECK(again->reward == RoundReward(read->reward));
  CRAFTFLEET_CHECK(FormatStatsLine(*again) == text);
}

void TryInput(absl::string_view input) {
  for (const absl::string_view line : absl::StrSplit(input, '\n')) TryLine(line);
}

std::vector<std::string> SoundInputs() {
  Episode episode;
  episode.length = 163;
  episode.reward = 1.1;
  for (int i = 0; i < kNumAchievements; ++i) episode.achievements[i] = i * i;  // all different
  Episode other;
  other.length = 10000;
  other.reward = -0.9;
  Episode unrounded;
  unrounded.length = 2;
  unrounded.reward = 0.25;
  return {FormatStatsLine(episode) + FormatStatsLine(other), FormatStatsLine(other), FormatStatsLine(unrounded), ""};
}

const FuzzTarget kTarget("stats", TryInput, SoundInputs);

}  // namespace stats

// A checkpoint's files: refused, or with a consistent state. The first byte selects the file that is changed; the
// manifest's checksums are correct otherwise, so that the search gets past them.
namespace checkpoint {

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
  const auto loaded = LoadCheckpoint(folder);
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

const FuzzTarget kTarget("checkpoint", TryInput, SoundInputs);

}  // namespace checkpoint

}  // namespace
}  // namespace craftfleet
