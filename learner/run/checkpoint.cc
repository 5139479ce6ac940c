#include "learner/run/checkpoint.h"

#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>

#include "common/base/check.h"
#include "common/base/crc32c.h"
#include "common/base/printable.h"
#include "common/base/range_check.h"
#include "common/base/seeds.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {
namespace {

constexpr char kManifest[] = "MANIFEST";
constexpr absl::string_view kFormatPrefix = "craftfleet checkpoint, format ";
constexpr absl::string_view kProgramPrefix = "program ";
constexpr absl::string_view kStateFile = "state.pb";
constexpr absl::string_view kWeightsFile = "weights.safetensors";
constexpr absl::string_view kOptimizerFile = "optimizer.safetensors";
constexpr absl::string_view kPlayWeightsFile = "play.safetensors";
constexpr size_t kMaxRunIdBytes = 512;  // the most that an actor accepts
constexpr int kMaxPending = 16;         // a learner begins no evaluation while three are pending

std::string EvaluationFile(const v1::PendingEvaluation& evaluation) {
  return absl::StrFormat("evaluation-%d.safetensors", evaluation.number());
}

std::string ManifestLine(absl::string_view name, absl::string_view bytes) {
  return absl::StrFormat("%s %d %08x\n", name, bytes.size(), Crc32c(bytes));
}

absl::Status Torn(absl::string_view folder, absl::string_view how) {
  return absl::DataLossError(absl::StrCat("checkpoint ", folder, " is torn: ", how));
}

// Checks the manifest's format and program, and returns the lines after these.
absl::StatusOr<std::vector<std::string>> ReadManifest(const std::string& folder) {
  const absl::StatusOr<std::string> text = ReadFile(JoinPath(folder, kManifest));
  if (!text.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(folder, " is not a checkpoint: ", text.status().message()));
  }
  std::vector<std::string> lines = absl::StrSplit(*text, '\n');
  absl::string_view format_text = lines[0];
  int format = 0;
  if (!absl::ConsumePrefix(&format_text, kFormatPrefix) || !absl::SimpleAtoi(format_text, &format)) {
    return absl::InvalidArgumentError(absl::StrCat(folder, " is not a checkpoint: its ", kManifest,
                                                   " does not begin with \"", kFormatPrefix, "\" and a number"));
  }
  if (lines.size() < 2 || !absl::StartsWith(lines[1], kProgramPrefix)) {
    return Torn(folder, "MANIFEST has no program version");
  }
  const std::string program = lines[1].substr(kProgramPrefix.size());
  if (format != kCheckpointFormat) {
    const absl::string_view advice = format > kCheckpointFormat
                                         ? "use that version or a newer one"
                                         : "finish the run with that version, or start a new one";
    return absl::FailedPreconditionError(absl::StrCat("checkpoint ", folder, " has format ", format,
                                                      ", written by craftfleet ", program,
                                                      "; this program reads format ", kCheckpointFormat, ": ", advice));
  }
  lines.erase(lines.begin(), lines.begin() + 2);
  return lines;
}

// The bytes of `name`, checked against its line in the manifest.
absl::StatusOr<std::string> ReadListedFile(const std::string& folder, absl::string_view name,
                                           const std::vector<std::string>& manifest) {
  for (const std::string& line : manifest) {
    const std::vector<absl::string_view> fields = absl::StrSplit(line, ' ');
    if (fields[0] != name) continue;
    uint64_t size = 0;
    if (fields.size() != 3 || !absl::SimpleAtoi(fields[1], &size)) break;
    const std::string path = JoinPath(folder, name);
    absl::StatusOr<std::string> bytes = ReadFile(path);
    if (absl::IsNotFound(bytes.status())) return Torn(folder, absl::StrCat(name, " is missing"));
    CRAFTFLEET_RETURN_IF_ERROR(bytes.status());
    if (bytes->size() != size) return Torn(folder, absl::StrCat(name, " has ", bytes->size(), " of ", size, " bytes"));
    if (absl::StrCat(line, "\n") != ManifestLine(name, *bytes)) {
      return Torn(folder, absl::StrFormat("%s has checksum %08x, want %s", name, Crc32c(*bytes), fields[2]));
    }
    return bytes;
  }
  return Torn(folder, absl::StrCat("MANIFEST does not list ", name));
}

absl::Status CheckPending(const v1::PendingEvaluation& evaluation) {
  RangeCheck check;
  check.Within<int64_t>("pending.number", evaluation.number(), 1, kMaxCount);
  check.Within<int64_t>("pending.env_steps", evaluation.env_steps(), 0, kMaxCount);
  check.Within("pending.episodes", evaluation.episodes(), 1, kMaxEvaluationEpisodes);
  check.Within<int64_t>("pending.first_episode", evaluation.first_episode(), 1,
                        kLastEvaluationEpisode + 1 - int64_t{2} * evaluation.episodes());
  return check.status();
}

void CheckPlay(const v1::PlayWeights& play, RangeCheck* check) {
  check->Within<int64_t>("play.policy_version", play.policy_version(), 0, kMaxCount);
  check->Within("play.value_mean", play.value_mean(), -kMaxReturn, kMaxReturn);
  check->Positive("play.value_deviation", play.value_deviation(), kMaxReturn);  // in the beginning ppo.value_norm_start
}

absl::StatusOr<v1::CheckpointState> ReadState(const std::string& folder, const std::vector<std::string>& manifest) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string bytes, ReadListedFile(folder, kStateFile, manifest));
  v1::CheckpointState state;
  if (!state.ParseFromString(bytes)) return Torn(folder, absl::StrCat(kStateFile, " is not a CheckpointState"));
  if (const absl::Status status = CheckCheckpointState(state); !status.ok()) {
    return absl::DataLossError(absl::StrCat("checkpoint ", folder, ": ", kStateFile, ": ", status.message()));
  }
  return state;
}

}  // namespace

absl::Status CheckCheckpointState(const v1::CheckpointState& state) {
  CRAFTFLEET_RETURN_IF_ERROR(ValidateRunConfig(state.config()));
  RangeCheck check;
  for (const auto& [field, count] :
       {std::pair("iteration", state.iteration()), std::pair("env_steps", state.env_steps()),
        std::pair("policy_version", state.policy_version()), std::pair("optimizer_steps", state.optimizer_steps()),
        std::pair("evaluations", state.evaluations()),
        std::pair("final_evaluation_steps", state.final_evaluation_steps())}) {
    check.Within<int64_t>(field, count, 0, kMaxCount);
  }
  check.Within<int64_t>("next_eval_episode", state.next_eval_episode(), 0, kLastEvaluationEpisode);
  check.Within("train_seconds", state.train_seconds(), 0.0, static_cast<double>(kMaxCount));
  check.That(state.best_score() < std::numeric_limits<double>::infinity(),
             absl::StrCat("best_score is ", state.best_score(), ", want a finite number or -inf"));
  check.That(
      state.run_id().size() <= kMaxRunIdBytes && Printable(state.run_id()) == state.run_id(),
      absl::StrCat("run_id has ", state.run_id().size(), " bytes, want printable ones, at most ", kMaxRunIdBytes));
  check.That(state.lanes_size() == state.config().lanes(),
             absl::StrCat("it has ", state.lanes_size(), " lanes, its configuration ", state.config().lanes()));
  for (const v1::LaneState& lane : state.lanes()) {
    check.Within<int64_t>("lanes.next_fragment", lane.next_fragment(), 0, kMaxCount);
  }
  for (const v1::LogLength& log : state.logs()) check.Within<int64_t>("logs.bytes", log.bytes(), 0, kMaxCount);
  check.Within("pending evaluations", state.pending_size(), 0, kMaxPending);
  if (state.has_play()) CheckPlay(state.play(), &check);
  CRAFTFLEET_RETURN_IF_ERROR(check.status());
  for (const v1::PendingEvaluation& evaluation : state.pending()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckPending(evaluation));
  }
  return absl::OkStatus();
}

absl::Status WriteCheckpointFiles(const std::string& folder, const Checkpoint& checkpoint) {
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  v1::CheckpointState state = checkpoint.state;
  state.set_format(kCheckpointFormat);
  const std::string state_bytes = state.SerializeAsString();
  CRAFTFLEET_CHECK(static_cast<int>(checkpoint.evaluation_weights.size()) == state.pending_size());
  std::vector<std::pair<std::string, const std::string*>> files = {
      {std::string(kStateFile), &state_bytes},
      {std::string(kWeightsFile), checkpoint.weights.get()},
      {std::string(kOptimizerFile), &checkpoint.optimizer}};
  if (state.has_play()) files.emplace_back(kPlayWeightsFile, checkpoint.play_weights.get());
  for (int i = 0; i < state.pending_size(); ++i) {
    files.emplace_back(EvaluationFile(state.pending(i)), checkpoint.evaluation_weights[i].get());
  }
  std::string manifest =
      absl::StrCat(kFormatPrefix, kCheckpointFormat, "\n", kProgramPrefix, state.program_version(), "\n");
  for (const auto& [name, bytes] : files) {
    CRAFTFLEET_RETURN_IF_ERROR(WriteFileSynced(JoinPath(folder, name), *bytes));
    manifest += ManifestLine(name, *bytes);
  }
  CRAFTFLEET_RETURN_IF_ERROR(WriteFileSynced(JoinPath(folder, kManifest), manifest));
  return SyncFolder(folder);
}

absl::StatusOr<v1::CheckpointState> LoadCheckpointState(const std::string& folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> manifest, ReadManifest(folder));
  return ReadState(folder, manifest);
}

absl::StatusOr<Checkpoint> LoadCheckpoint(const std::string& folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> manifest, ReadManifest(folder));
  Checkpoint checkpoint;
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.state, ReadState(folder, manifest));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string weights, ReadListedFile(folder, kWeightsFile, manifest));
  checkpoint.weights = std::make_shared<const std::string>(std::move(weights));
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.optimizer, ReadListedFile(folder, kOptimizerFile, manifest));
  if (checkpoint.state.has_play()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(std::string weights, ReadListedFile(folder, kPlayWeightsFile, manifest));
    checkpoint.play_weights = std::make_shared<const std::string>(std::move(weights));
  }
  for (const v1::PendingEvaluation& evaluation : checkpoint.state.pending()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(std::string weights, ReadListedFile(folder, EvaluationFile(evaluation), manifest));
    checkpoint.evaluation_weights.push_back(std::make_shared<const std::string>(std::move(weights)));
  }
  return checkpoint;
}

}  // namespace craftfleet
