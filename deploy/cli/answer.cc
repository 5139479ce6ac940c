#include "deploy/cli/answer.h"

#include <cstdint>
#include <utility>

#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>
#include <google/protobuf/util/json_util.h>
#include <nlohmann/json.hpp>

#include "common/base/status_macros.h"
#include "common/config/agent_presets.h"
#include "common/config/config.h"
#include "common/config/env_name.h"
#include "common/config/known_canary.h"
#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "common/process/cgroup.h"
#include "learner/run/checkpoint.h"
#include "learner/run/checkpoint_store.h"

namespace craftfleet {
namespace {

using Json = nlohmann::json;

// A name that can't be parsed is kept: the run reports its error.
std::string CanonicalEnv(const std::string& name) {
  const absl::StatusOr<EnvName> parsed = EnvName::Parse(name);
  return parsed.ok() ? parsed->ToString() : name;
}

absl::Status CheckEnv(const char* field, const std::string& name) {
  const absl::Status status = EnvName::Parse(name).status();
  return status.ok() ? status : absl::InvalidArgumentError(absl::StrCat(field, ": ", status.message()));
}

const std::string& EvalEnv(const v1::RunConfig& config) {
  return config.eval().env().empty() ? config.env().name() : config.eval().env();
}

absl::Status CheckEnvs(const v1::RunConfig& config) {
  absl::Status status = CheckEnv("env.name", config.env().name());
  status.Update(CheckEnv("eval.env", EvalEnv(config)));
  return status;
}

// The part of a complete configuration that affects learning or the measures: without the seed, checkpoints, the
// frequency of evaluations, and technical settings (tile, gradient shards, cpu, device). Environments have their
// canonical names.
v1::RunConfig ShapingConfig(const v1::RunConfig& config) {
  v1::RunConfig shaping = config;
  shaping.clear_seed();
  shaping.clear_checkpoint();
  shaping.clear_tile();
  shaping.clear_gradient_shards();
  shaping.clear_cpu();     // changes only the last bits of numbers
  shaping.clear_device();  // likewise
  // Resolved, so that values given explicitly and values of the agent compare equal.
  *shaping.mutable_network() = ResolveNetwork(config).value_or(config.network());
  shaping.clear_eval();
  shaping.mutable_eval()->set_env(CanonicalEnv(EvalEnv(config)));
  shaping.mutable_env()->set_name(CanonicalEnv(config.env().name()));
  shaping.mutable_env()->clear_frame_size();  // the agent determines it when the run starts
  return shaping;
}

// ShapingConfig as text, and the textures of the run if they are not those that come with the programs. Runs may be
// averaged if their identities are equal.
std::string RunIdentity(const v1::RunConfig& config, absl::string_view texture_digest) {
  const bool built_in = texture_digest.empty() || texture_digest == kBuiltInTextures;
  return absl::StrCat(FormatRunConfig(ShapingConfig(config)),
                      built_in ? "" : absl::StrCat("# textures ", texture_digest, "\n"));
}

absl::StatusOr<Json> JsonOf(const v1::RunConfig& config) {
  std::string text;
  google::protobuf::util::JsonPrintOptions options;
  options.preserve_proto_field_names = true;
  const auto status = google::protobuf::util::MessageToJsonString(config, &text, options);
  if (!status.ok()) return absl::InternalError(std::string(status.message()));
  return Json::parse(text);
}

// The settings that may distinguish runs, without the agent. Network settings only if they were given; the others
// follow from the agent.
absl::StatusOr<Json> SettingsOf(const v1::RunConfig& config) {
  v1::RunConfig settings = ShapingConfig(config);
  *settings.mutable_network() = config.network();
  settings.clear_agent();
  // Trained and evaluated on the same environment: env.name is enough.
  if (settings.eval().env() == settings.env().name()) settings.clear_eval();
  return JsonOf(settings);
}

// The agent's defaults in a run with the lanes and rollout of `config`, from which that of fragment_steps follows.
absl::StatusOr<Json> DefaultsOf(const v1::RunConfig& config) {
  v1::RunConfig given;
  given.set_agent(config.agent());
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::RunConfig defaults, ResolveRunConfig(given));
  given.set_lanes(config.lanes());
  given.mutable_ppo()->set_rollout_steps(config.ppo().rollout_steps());
  defaults.set_fragment_steps(ResolveRunConfig(given).value_or(config).fragment_steps());
  return SettingsOf(defaults);
}

absl::StatusOr<Json> AnswerConfig(const Json& question) {
  const std::string path = question.value("path", "configuration");
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::RunConfig config, ParseRunConfig(question["config"].get<std::string>(), path));
  absl::StatusOr<v1::RunConfig> resolved = ResolveRunConfig(std::move(config));
  absl::Status status = resolved.status();
  if (status.ok() && question.value("check_envs", false)) status = CheckEnvs(*resolved);
  if (!status.ok()) return absl::InvalidArgumentError(absl::StrCat(path, ": ", status.message()));
  CRAFTFLEET_ASSIGN_OR_RETURN(Json complete, JsonOf(*resolved));
  CRAFTFLEET_ASSIGN_OR_RETURN(Json settings, SettingsOf(*resolved));
  CRAFTFLEET_ASSIGN_OR_RETURN(Json defaults, DefaultsOf(*resolved));
  const std::string textures = question.value("textures", "");
  return Json{{"config", std::move(complete)},
              {"identity", RunIdentity(*resolved, textures)},
              {"settings", std::move(settings)},
              {"defaults", std::move(defaults)},
              {"built_in_textures", textures.empty() || textures == kBuiltInTextures},
              {"steps_to_train", StepsToTrain(*resolved)}};
}

// `steps`: those that the run is to reach. A folder without a checkpoint has no run that has begun.
absl::StatusOr<Json> AnswerFolder(const Json& question) {
  const absl::StatusOr<std::string> checkpoint = FindCheckpoint(question["folder"].get<std::string>());
  if (absl::IsNotFound(checkpoint.status())) return Json{{"begun", false}, {"steps", 0}, {"finished", false}};
  CRAFTFLEET_RETURN_IF_ERROR(checkpoint.status());
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::CheckpointState state, LoadCheckpointState(*checkpoint));
  const bool evaluated =
      state.config().eval().final_episodes() == 0 || state.final_evaluation_steps() == state.env_steps();
  const bool finished =
      state.env_steps() >= question.value("steps", int64_t{0}) && evaluated && state.pending_size() == 0;
  return Json{{"begun", true}, {"steps", state.env_steps()}, {"finished", finished}};
}

absl::StatusOr<Json> AnswerTextures(const Json& question) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string folder, TextureDir(question["textures_in"].get<std::string>()));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string digest, TextureDigest(folder));
  return Json{{"digest", std::move(digest)}};
}

absl::StatusOr<Json> AnswerParsed(const Json& question) {
  if (question.contains("config")) return AnswerConfig(question);
  if (question.contains("folder")) return AnswerFolder(question);
  if (question.contains("textures_in")) return AnswerTextures(question);
  if (question.contains("machine")) return Json{{"threads", DefaultThreads()}};
  return absl::InvalidArgumentError("not a question, want config, folder, textures_in or machine");
}

}  // namespace

std::string Answer(absl::string_view question) {
  absl::StatusOr<Json> answer = absl::InvalidArgumentError("not a JSON object");
  const Json parsed = Json::parse(question.begin(), question.end(), nullptr, /*allow_exceptions=*/false);
  try {
    if (parsed.is_object()) answer = AnswerParsed(parsed);
  } catch (const Json::exception& error) {  // a value of another type
    answer = absl::InvalidArgumentError(error.what());
  }
  if (!answer.ok()) answer = Json{{"error", std::string(answer.status().message())}};
  return answer->dump(-1, ' ', /*ensure_ascii=*/true, Json::error_handler_t::replace);
}

}  // namespace craftfleet
