#include "deploy/cli/checkpoint_policy.h"

#include <utility>

#include <absl/strings/str_cat.h>
#include <nlohmann/json.hpp>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "common/io/texture_digest.h"
#include "common/process/cpu_pin.h"
#include "common/telemetry/log.h"
#include "learner/run/checkpoint.h"
#include "learner/run/checkpoint_store.h"

namespace craftfleet {
namespace {

absl::Status ComputeAsTheRun(v1::RunConfig::Cpu cpu) {
  const absl::Status status = CheckCpu(cpu);
  if (status.ok()) return PinCpu(cpu);
  LogWarning("%s; the policy may act differently here", status.message());
  return absl::OkStatus();
}

bool IsResult(const std::string& path) {
  return PathExists(JoinPath(path, "config.txt")) && PathExists(JoinPath(path, "weights.safetensors"));
}

// The final weights of a finished run, with what its configuration says of it.
absl::StatusOr<Checkpoint> LoadResult(const std::string& folder) {
  Checkpoint checkpoint;
  const std::string config_path = JoinPath(folder, "config.txt");
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(config_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::RunConfig given, ParseRunConfig(text, config_path));
  CRAFTFLEET_ASSIGN_OR_RETURN(*checkpoint.state.mutable_config(), ResolveRunConfig(std::move(given)));
  checkpoint.state.set_env_steps(StepsToTrain(checkpoint.state.config()));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string run, ReadFile(JoinPath(folder, "run.json")));
  const auto json = nlohmann::json::parse(run, nullptr, /*allow_exceptions=*/false);
  const auto id = json.is_object() ? json.find("run_id") : json.end();
  if (id == json.end() || !id->is_string()) {
    return absl::DataLossError(absl::StrCat(folder, "/run.json has no run_id"));
  }
  checkpoint.state.set_run_id(id->get<std::string>());
  const auto textures = json.find("texture_digest");
  if (textures != json.end() && textures->is_string()) {
    checkpoint.state.set_texture_digest(textures->get<std::string>());
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string weights, ReadFile(JoinPath(folder, "weights.safetensors")));
  checkpoint.weights = std::make_shared<const std::string>(std::move(weights));
  return checkpoint;
}

absl::StatusOr<Checkpoint> Load(const std::string& path, std::string* folder) {
  absl::StatusOr<Checkpoint> found = LoadFound(path, folder);
  if (!absl::IsNotFound(found.status()) || !IsResult(path)) return found;
  *folder = path;
  return LoadResult(path);
}

}  // namespace

absl::StatusOr<CheckpointPolicy> LoadPolicy(const std::string& path) {
  CheckpointPolicy loaded;
  CRAFTFLEET_ASSIGN_OR_RETURN(Checkpoint checkpoint, Load(path, &loaded.folder));
  const v1::RunConfig& config = checkpoint.state.config();
  CRAFTFLEET_RETURN_IF_ERROR(ComputeAsTheRun(config.cpu()));
  SetUpTorchThread();
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.spec, MakeAgentSpec(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.policy, Policy::Create(loaded.spec, checkpoint.weights, config.tile()));
  loaded.state = std::move(checkpoint.state);
  return loaded;
}

absl::Status CheckTextures(const v1::CheckpointState& state, absl::string_view digest) {
  if (state.texture_digest().empty()) return absl::OkStatus();
  return CheckTextureDigest("the run", state.texture_digest(), digest);
}

}  // namespace craftfleet
