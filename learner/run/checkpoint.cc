#include "learner/run/checkpoint.h"

#include <cstdint>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>

#include "common/check.h"
#include "common/config.h"
#include "common/crc32c.h"
#include "common/files.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

constexpr char kManifest[] = "MANIFEST";
constexpr absl::string_view kFormatPrefix = "craftfleet checkpoint, format ";
constexpr absl::string_view kProgramPrefix = "program ";
constexpr absl::string_view kStateFile = "state.pb";
constexpr absl::string_view kWeightsFile = "weights.safetensors";
constexpr absl::string_view kOptimizerFile = "optimizer.safetensors";

std::string EvaluationFile(const v1::PendingEvaluation& evaluation) {
  return absl::StrFormat("evaluation-%d.safetensors", evaluation.number());
}

std::string ManifestLine(absl::string_view name, absl::string_view bytes) {
  return absl::StrFormat("%s %d %08x\n", name, bytes.size(), Crc32c(bytes));
}

absl::Status Torn(absl::string_view folder, absl::string_view how) {
  return absl::DataLossError(absl::StrCat("checkpoint ", folder, " is torn: ", how));
}

// The manifest's lines after format and program, which are checked.
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
  if (format > kCheckpointFormat) {
    return absl::FailedPreconditionError(
        absl::StrCat("checkpoint ", folder, " has format ", format, ", written by craftfleet ", program,
                     "; this program reads formats up to ", kCheckpointFormat, ": use that version or a newer one"));
  }
  lines.erase(lines.begin(), lines.begin() + 2);
  return lines;
}

// Bytes of `name`, which must be as its line in the manifest says.
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

absl::Status CheckState(const v1::CheckpointState& state) {
  CRAFTFLEET_RETURN_IF_ERROR(ValidateRunConfig(state.config()));
  if (state.iteration() < 0 || state.env_steps() < 0 || state.policy_version() < 0 || state.optimizer_steps() < 0) {
    return absl::InvalidArgumentError("a counter is negative");
  }
  if (state.lanes_size() != state.config().lanes()) {
    return absl::InvalidArgumentError(
        absl::StrCat("it has ", state.lanes_size(), " lanes, its configuration ", state.config().lanes()));
  }
  for (const v1::PendingEvaluation& evaluation : state.pending()) {
    if (evaluation.number() < 1 || evaluation.first_episode() < 1 || evaluation.episodes() < 1) {
      return absl::InvalidArgumentError("a pending evaluation has a number, an episode or a count below 1");
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<v1::CheckpointState> ReadState(const std::string& folder, const std::vector<std::string>& manifest) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string bytes, ReadListedFile(folder, kStateFile, manifest));
  v1::CheckpointState state;
  if (!state.ParseFromString(bytes)) return Torn(folder, absl::StrCat(kStateFile, " is not a CheckpointState"));
  if (const absl::Status status = CheckState(state); !status.ok()) {
    return absl::DataLossError(absl::StrCat("checkpoint ", folder, ": ", kStateFile, ": ", status.message()));
  }
  return state;
}

}  // namespace

absl::Status WriteCheckpointFiles(const std::string& folder, const Checkpoint& checkpoint) {
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  v1::CheckpointState state = checkpoint.state;
  state.set_format(kCheckpointFormat);
  const std::string state_bytes = state.SerializeAsString();
  CRAFTFLEET_CHECK(static_cast<int>(checkpoint.evaluation_weights.size()) == state.pending_size());
  std::vector<std::pair<std::string, const std::string*>> files = {
      {std::string(kStateFile), &state_bytes},
      {std::string(kWeightsFile), &checkpoint.weights},
      {std::string(kOptimizerFile), &checkpoint.optimizer}};
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

absl::StatusOr<Checkpoint> LoadCheckpoint(const std::string& folder, absl::string_view agent) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> manifest, ReadManifest(folder));
  Checkpoint checkpoint;
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.state, ReadState(folder, manifest));
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.weights, ReadListedFile(folder, kWeightsFile, manifest));
  CRAFTFLEET_ASSIGN_OR_RETURN(checkpoint.optimizer, ReadListedFile(folder, kOptimizerFile, manifest));
  for (const v1::PendingEvaluation& evaluation : checkpoint.state.pending()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(std::string weights, ReadListedFile(folder, EvaluationFile(evaluation), manifest));
    checkpoint.evaluation_weights.push_back(std::make_shared<const std::string>(std::move(weights)));
  }
  const std::string& own_agent = checkpoint.state.config().agent();
  if (!agent.empty() && own_agent != agent) {
    return absl::FailedPreconditionError(absl::StrCat("checkpoint ", folder, " is of agent ", own_agent, ", not of ",
                                                      agent, ": name that agent or another checkpoint"));
  }
  return checkpoint;
}

}  // namespace craftfleet
