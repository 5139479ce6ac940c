#include "learner/learner.h"

#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/agent/agent_spec.h"
#include "common/agent/canary.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/config/env_name.h"
#include "common/config/known_canary.h"
#include "common/io/files.h"
#include "common/io/snapshot_envelope.h"
#include "common/io/texture_digest.h"
#include "common/process/version.h"
#include "common/telemetry/log.h"
#include "envserver/canary.h"
#include "envserver/render/renderer.h"
#include "envserver/render/textures.h"
#include "envserver/world/options.h"
#include "learner/runnable_config.h"
#include "learner/service/fleet_summary.h"
#include "learner/training/records/lane_loading.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLease = absl::Seconds(5);
// Servers report once a second, actors twice. Like an actor, a server that was suspended for 4 s must stay listed.
constexpr absl::Duration kServerLease = absl::Seconds(8);

// Whether actors that act elsewhere, or on the CPU, want weights that a GPU has.
bool SendsWeights(const Learner::Options& options, const v1::RunConfig& config) {
  return !options.server.address.empty() || config.device() == v1::RunConfig::CUDA_UPDATES;
}

// How `asked` differs from `stored`, a configuration that may lack defaults, apart from what a resumed run may change.
absl::StatusOr<std::string> FixedDifferences(v1::RunConfig stored, v1::RunConfig asked) {
  CRAFTFLEET_ASSIGN_OR_RETURN(stored, CompleteConfig(std::move(stored)));
  asked.set_steps(stored.steps());
  *asked.mutable_checkpoint() = stored.checkpoint();
  return Differences(stored, asked);
}

std::string ConfigPath(const std::string& logdir) { return JoinPath(logdir, "config.txt"); }

// FailedPrecondition if the run in `logdir` has another configuration than `asked`, apart from steps and checkpoints.
absl::Status CheckSameRun(const std::string& logdir, const v1::RunConfig& asked) {
  const std::string path = ConfigPath(logdir);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::RunConfig stored, ParseRunConfig(text, path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string differences, FixedDifferences(stored, asked));
  if (differences.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      "the run in ", logdir, " has another configuration (only steps and checkpoint may change): ", differences));
}

// InvalidArgument if the run is to train fewer steps than it has.
absl::Status CheckStepsLeft(const v1::RunConfig& config, const v1::CheckpointState& state) {
  if (StepsToTrain(config) >= state.env_steps()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("--steps=", config.steps(), ": the run has ", state.env_steps(),
                   " steps already; want more, or go back to an older checkpoint with --resume_from"));
}

// DataLoss if the checkpoint's configuration is another than `config`, which agrees with the run's config.txt.
absl::Status CheckConfigFile(const std::string& logdir, const v1::CheckpointState& state, const v1::RunConfig& config) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string differences, FixedDifferences(state.config(), config));
  if (differences.empty()) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(ConfigPath(logdir),
                                          " is not the configuration of the run's checkpoint after iteration ",
                                          state.iteration(), ": undo these changes in it: ", differences));
}

// Loads the weights of the checkpoint or run folder at `path` into `updater`. Returns their origin, for run.json.
absl::StatusOr<std::string> InitFrom(const std::string& path, const v1::RunConfig& config, PpoUpdater* updater) {
  const auto load = [&]() -> absl::StatusOr<std::string> {
    std::string folder;
    CRAFTFLEET_ASSIGN_OR_RETURN(const Checkpoint checkpoint, LoadFound(path, &folder));
    if (const std::string& agent = checkpoint.state.config().agent(); agent != config.agent()) {
      return absl::FailedPreconditionError(absl::StrCat("checkpoint ", folder, " is of agent ", agent, ", not of ",
                                                        config.agent(), ": name that agent or another checkpoint"));
    }
    CRAFTFLEET_RETURN_IF_ERROR(updater->StartFrom(*checkpoint.weights, checkpoint.optimizer));
    const v1::CheckpointState& state = checkpoint.state;
    return absl::StrFormat("run %s after iteration %d, %d steps", state.run_id(), state.iteration(), state.env_steps());
  };
  absl::StatusOr<std::string> origin = load();
  if (!origin.ok()) {
    return absl::Status(origin.status().code(), absl::StrCat("--init_from: ", origin.status().message()));
  }
  LogInfo("starting with the weights of %s", *origin);
  return origin;
}

// DataLoss unless each lane of the checkpoint has a recurrent state of the agent's size.
absl::Status CheckLaneStates(const v1::CheckpointState& state, int state_size) {
  for (int i = 0; i < state.lanes_size(); ++i) {
    if (state.lanes(i).state_size() == state_size) continue;
    return absl::DataLossError(absl::StrFormat("the checkpoint's lane %d has a recurrent state of %d numbers, want %d",
                                               i, state.lanes(i).state_size(), state_size));
  }
  return absl::OkStatus();
}

std::string PrecisionName(const v1::RunConfig& config) {
  return config.has_precision() ? v1::RunConfig::Precision_Name(config.precision()) : "FP32";
}

// Of the game with these textures.
absl::StatusOr<std::string> ExpectedGame(const Textures& textures, absl::string_view texture_digest) {
  const absl::string_view known = KnownGameCanary(texture_digest);
  if (!known.empty()) return std::string(known);
  return GameCanary(textures);
}

// InvalidArgument if the textures lack variants of objects that an environment of the run shows.
absl::Status CheckDrawable(const Textures& textures, const v1::RunConfig& config) {
  for (const std::string& env : {config.env().name(), config.eval().env()}) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(env));
    const absl::Status status = Renderer::Create(textures, WorldOptions::FromEnvName(name), {}).status();
    if (status.ok()) continue;
    return absl::InvalidArgumentError(
        absl::StrFormat("environment %s: %s; give --textures with all variants of objects", env, status.message()));
  }
  return absl::OkStatus();
}

// The build that workers of the run must match, with this canary of their game.
absl::StatusOr<BuildCheck::Options> ExpectedBuild(const v1::RunConfig& config, const std::string& game_canary,
                                                  bool allow_mixed) {
  absl::StatusOr<std::string> canary = PolicyCanary(config);
  // A learner that updates on a GPU need not be able to act on its CPU.
  if (config.device() == v1::RunConfig::CUDA_UPDATES && absl::IsInvalidArgument(canary.status())) {
    LogWarning("%s; so this learner accepts actors whatever they compute", canary.status().message());
    canary = std::string();
  }
  CRAFTFLEET_RETURN_IF_ERROR(canary.status());
  const absl::string_view known = KnownPolicyCanary(config.cpu());
  if (!known.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string float32_canary, PolicyCanary());
    if (float32_canary != known) {
      LogWarning("with cpu: %s the canary of this machine is %s, want %s: other machines may compute different results",
                 v1::RunConfig::Cpu_Name(config.cpu()), float32_canary, known);
    }
  }
  return BuildCheck::Options{BuildId(), *canary, game_canary, allow_mixed};
}

// Whether so many ranks can share out the updates of such a run.
absl::Status CheckRanks(const v1::RunConfig& config, const Learner::Options& options) {
  const int ranks = options.ranks.world_size;
  if (ranks > 1 && options.device != "cpu") {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s with updates on %s: several learners compute on CPUs only; give --device=cpu",
                        options.ranks.given, options.device));
  }
  if (ranks <= config.gradient_shards()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("%s, but gradient_shards is %d: start at most that many learners, or raise gradient_shards in "
                      "--config; a learner "
                      "that is alone wants --world_size=1",
                      options.ranks.given, config.gradient_shards()));
}

size_t FragmentsPerIteration(const v1::RunConfig& config) {
  return static_cast<size_t>(config.ppo().rollout_steps() / config.fragment_steps());
}

WorkerRegistry::Options RegistryOptions(const v1::RunConfig& config, int resets, BuildCheck::Options build) {
  WorkerRegistry::Options options;
  options.lanes.resets = resets;
  options.lanes.lanes = config.lanes();
  options.lanes.lease = kLease;
  options.lanes.max_staleness = config.max_staleness();
  options.lanes.rollout_fragments = static_cast<int64_t>(FragmentsPerIteration(config));
  options.server_lease = kServerLease;
  options.build = std::move(build);
  return options;
}

}  // namespace

struct Learner::Loaded {
  v1::RunConfig config;
  std::unique_ptr<Clock> clock;
  std::unique_ptr<RunFolder> folder;
  std::unique_ptr<PpoUpdater> updater;
  Checkpoint checkpoint;  // empty for a new run; without weights and optimiser, which the updater has
  wire::FragmentShape shape;
  LoadedLanes lanes;
  std::string texture_digest;
  BuildCheck::Options build;
  std::shared_ptr<const wire::AccessControl> access;  // null: no access file
};

absl::StatusOr<std::unique_ptr<Learner>> Learner::Create(const Options& options) {
  CRAFTFLEET_RETURN_IF_ERROR(options.server.Validate());
  absl::StatusOr<v1::RunConfig> config = CompleteConfig(options.config);
  if (!config.ok() && options.resume) {
    return absl::Status(config.status().code(),
                        absl::StrCat("with --resume, only --steps and the checkpoint settings may change: ",
                                     config.status().message()));
  }
  if (!config.ok()) return config.status();
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(*config));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRunnable(*config, spec, {OwnMemoryBytes(), options.device == "cpu"}));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRanks(*config, options));
  CRAFTFLEET_ASSIGN_OR_RETURN(Loaded loaded, Load(options, *config));
  loaded.shape = FragmentShapeOf(*config, spec);
  loaded.lanes = LoadLanes(loaded.checkpoint.state, loaded.shape);
  wire::Server::Options server = options.server;
  server.max_message_bytes = LargestMessageBytes(loaded.shape);
  CRAFTFLEET_RETURN_IF_ERROR(server.OpenAccess());
  loaded.access = server.access;
  std::unique_ptr<Learner> learner(new Learner(options, std::move(loaded)));
  CRAFTFLEET_ASSIGN_OR_RETURN(
      learner->server_,
      wire::Server::Create(server, {&learner->service_, &learner->admin_service_, &learner->status_service_}));
  if (!options.http_address.empty()) CRAFTFLEET_RETURN_IF_ERROR(learner->ServePage(options, server.access));
  return learner;
}

absl::Status Learner::ServePage(const Options& options, std::shared_ptr<wire::AccessControl> access) {
  const LivePage::Options page = {options.http_address, options.server.files, std::move(access), options.http_hosts};
  CRAFTFLEET_ASSIGN_OR_RETURN(page_, LivePage::Create(page, {folder_->run_id(), folder_->logdir(), config_,
                                                             [this] { return status_service_.Snapshot(); },
                                                             &trainer_.status(), &steering_, clock_.get()}));
  return absl::OkStatus();
}

absl::StatusOr<Learner::Loaded> Learner::Load(const Options& options, const v1::RunConfig& config) {
  Loaded loaded;
  loaded.config = config;
  loaded.clock = std::make_unique<RealClock>();
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.texture_digest, TextureDigest(options.texture_dir));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::shared_ptr<const Textures> textures, Textures::Load(options.texture_dir));
  CRAFTFLEET_RETURN_IF_ERROR(CheckDrawable(*textures, config));
  const bool loads_weights = options.resume || !options.init_from.empty();
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.updater, PpoUpdater::Create(config, options.threads, options.device,
                                                                 loads_weights ? PpoUpdater::Start::kZeros
                                                                               : PpoUpdater::Start::kInitialWeights));
  if (options.device != "cpu") LogInfo("updates on %s, precision %s", options.device, PrecisionName(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string game, ExpectedGame(*textures, loaded.texture_digest));
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.build, ExpectedBuild(config, game, options.allow_mixed));
  if (!options.resume) {
    std::string origin;
    if (!options.init_from.empty()) {
      CRAFTFLEET_ASSIGN_OR_RETURN(origin, InitFrom(options.init_from, config, loaded.updater.get()));
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(
        loaded.folder, RunFolder::Create(options.logdir, config, loaded.texture_digest, loaded.clock.get(), origin));
    return loaded;
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckSameRun(options.logdir, config));
  CRAFTFLEET_ASSIGN_OR_RETURN(ResumedRun run, RunFolder::Resume(options.logdir, options.resume_from,
                                                                loaded.texture_digest, loaded.clock.get()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckConfigFile(options.logdir, run.checkpoint.state, config));
  CRAFTFLEET_RETURN_IF_ERROR(CheckStepsLeft(config, run.checkpoint.state));
  if (absl::Status load = loaded.updater->Load(*run.checkpoint.weights, run.checkpoint.optimizer); !load.ok()) {
    const std::string name = CheckpointName(run.checkpoint.state.iteration());
    return absl::DataLossError(absl::StrCat("checkpoint ", name, " of ", options.logdir, ": ", load.message()));
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckLaneStates(run.checkpoint.state, loaded.updater->spec().state_size));
  run.folder->TakeChanges(config);
  loaded.folder = std::move(run.folder);
  loaded.checkpoint = std::move(run.checkpoint);
  loaded.checkpoint.weights.reset();
  loaded.checkpoint.optimizer.clear();
  LogInfo("run %s resumes after iteration %d, %d steps", loaded.folder->run_id(), loaded.checkpoint.state.iteration(),
          loaded.checkpoint.state.env_steps());
  return loaded;
}

Learner::Learner(const Options& options, Loaded loaded)
    : config_(std::move(loaded.config)),
      clock_(std::move(loaded.clock)),
      folder_(std::move(loaded.folder)),
      updater_(std::move(loaded.updater)),
      ranks_(options.ranks, {config_, loaded.texture_digest}, loaded.build.policy_canary),
      registry_(RegistryOptions(config_, loaded.lanes.resets, std::move(loaded.build)), std::move(loaded.lanes.records),
                clock_.get()),
      weights_(KeptVersions(config_)),
      fragments_(FragmentsPerIteration(config_) * (1 + config_.max_staleness())),
      evaluations_(config_.eval(), config_.steps(), loaded.checkpoint, &registry_, folder_.get()),
      progress_({options.progress_columns, loaded.checkpoint.state.env_steps(),
                 std::max(StepsToTrain(config_), loaded.checkpoint.state.env_steps()), folder_->run_id()},
                options.progress != nullptr ? options.progress : &null_stream_, clock_.get()),
      trainer_(config_, loaded.checkpoint,
               {folder_.get(), updater_.get(), &ranks_, &registry_, &weights_, &fragments_, &evaluations_, &progress_,
                &checkpoint_requests_, clock_.get(), SendsWeights(options, config_)}),
      service_(ServiceOptions(&loaded), &registry_, &weights_, &fragments_),
      steering_({&checkpoint_requests_, &registry_, [this] { Stop(); }}),
      admin_service_(&steering_),
      status_service_("learner", [this](v1::StatusReply* reply) { FillStatus(reply); }) {}

LearnerServiceImpl::Options Learner::ServiceOptions(Loaded* loaded) const {
  LearnerServiceImpl::Options service;
  service.run_id = folder_->run_id();
  service.epoch = folder_->epoch();
  service.config = config_;
  service.texture_digest = loaded->texture_digest;
  service.shape = loaded->shape;
  service.lease = kLease;
  service.access = std::move(loaded->access);
  return service;
}

void Learner::FillStatus(v1::StatusReply* reply) const {
  const std::vector<WorkerRegistry::WorkerInfo> workers = service_.FillStatus(reply);
  trainer_.FillStatus(reply);
  FleetView view = ViewFleet(trainer_.meter().Recent(), workers);
  view.finished = trainer_.finished();
  view.evaluating = trainer_.phase() == Trainer::Phase::kEvaluating;
  view.paused = registry_.lanes()->assignment().paused();
  view.plays_on = config_.overlap() > 0 || config_.max_staleness() > 0;
  *reply->mutable_fleet() = SummarizeFleet(view);
  CountWorkers(workers, reply->mutable_fleet());
}

absl::Status Learner::Run() {
  const absl::Status status = Train();
  checkpoint_requests_.Close();  // also if training never began: the server waits for who waits for a checkpoint
  // Actors learn from their next request that the run is over. If the learner exited first, they would wait for it.
  if (trainer_.finished()) registry_.WaitUntilEmpty(absl::Seconds(2));
  return status;
}

absl::Status Learner::Train() {
  CRAFTFLEET_RETURN_IF_ERROR(ranks_.Connect([this] { return trainer_.is_stopping(); }, updater_.get()));
  CRAFTFLEET_RETURN_IF_ERROR(folder_->Begin());
  absl::Status status = trainer_.Run();
  // After an error they end because rank 0 is lost.
  if (status.ok()) ranks_.End(trainer_.finished());
  return status;
}

}  // namespace craftfleet
