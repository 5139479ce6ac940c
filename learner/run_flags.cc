#include "learner/run_flags.h"

#include <unistd.h>

#include <cstdint>
#include <iostream>
#include <optional>
#include <utility>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>

#include "common/agent/device.h"
#include "common/config.h"
#include "common/cpu_pin.h"
#include "common/cpu_quota.h"
#include "common/files.h"
#include "common/paths.h"
#include "common/status_macros.h"
#include "common/wire/server_flags.h"
#include "learner/run/checkpoint_store.h"

ABSL_FLAG(std::optional<std::string>, agent, std::nullopt,
          "which agent learns; craftfleet agents lists them [ppo_cnn]");
ABSL_FLAG(std::optional<std::string>, env, std::nullopt,
          "what it plays: crafter, or with options joined by commas, such as\n"
          "crafter:numbers=easy-x2,appearance=25/25/25/25,inventory=off");
ABSL_FLAG(std::optional<std::string>, eval_env, std::nullopt,
          "what evaluation episodes are played on, such as crafter:appearance=0/33/33/34 [as --env]");
ABSL_FLAG(std::optional<int64_t>, steps, std::nullopt,
          "environment steps, all lanes together; the run ends with the iteration that reaches them [1000000]");
ABSL_FLAG(std::optional<uint64_t>, seed, std::nullopt, "seed of everything random in the run [0]");
ABSL_FLAG(
    std::optional<std::string>, cpu, std::nullopt,
    "instruction set that every process of the run computes with: native (the best of each CPU), avx2 or avx512;\n"
    "CPUs that differ give equal bytes only with the same one [native]");
ABSL_FLAG(std::optional<int32_t>, lanes, std::nullopt, "games played side by side [16]");
ABSL_FLAG(std::string, logdir, "", "folder of the run: configuration, stats.jsonl, curves, checkpoints (needed)");
ABSL_FLAG(
    bool, resume, false,
    "go on with the run in --logdir as if it had never stopped; only --steps and what concerns checkpoints may differ");
ABSL_FLAG(bool, autoresume, false,
          "as --resume if --logdir has a run, else begin one: for what starts the same command again after it ended");
ABSL_FLAG(std::string, resume_from, "", "with --resume: the checkpoint to go back to, like iter-00000020 [the newest]");
ABSL_FLAG(
    std::string, init_from, "",
    "begin a new run with old weights: a run's folder, which stands for its newest checkpoint, or a checkpoint's,\n"
    "of the same agent; optimiser, counters and everything else begin anew");
ABSL_FLAG(std::optional<int32_t>, checkpoint_every, std::nullopt,
          "iterations from one checkpoint to the next; the last is always written [10]");
ABSL_FLAG(std::optional<int32_t>, keep_checkpoints, std::nullopt,
          "how many of the newest checkpoints are kept, beside the best [3]");
ABSL_FLAG(std::string, config, "",
          "file with the run's configuration in protobuf text format, such as another run's config.txt;\n"
          "flags given beside it win");
ABSL_FLAG(std::string, textures, "",
          "folder with Crafter's textures as PNG, such as crafter/assets of the Python package\n"
          "[the ones that come with this program]");
ABSL_FLAG(int32_t, threads, 0, "threads of this process for its computing; 0: as many as its CPU quota allows");
ABSL_FLAG(std::string, device, "auto",
          "where updates are computed: auto (a GPU where there is one), cpu, cuda or cuda:N; wants a build against a\n"
          "LibTorch with CUDA. Runs on different devices differ in their last bits");

namespace craftfleet {
namespace {

bool Resuming() {
  return absl::GetFlag(FLAGS_resume) ||
         (absl::GetFlag(FLAGS_autoresume) && FindCheckpoint(absl::GetFlag(FLAGS_logdir)).ok());
}

absl::StatusOr<v1::RunConfig> BaseConfig(bool resume) {
  const std::string config = absl::GetFlag(FLAGS_config);
  if (config.empty() && !resume) return v1::RunConfig();
  const std::string path = config.empty() ? JoinPath(absl::GetFlag(FLAGS_logdir), "config.txt") : config;
  absl::StatusOr<std::string> text = ReadFile(path);
  if (!text.ok()) {
    return absl::Status(text.status().code(),
                        config.empty() ? absl::StrFormat("--resume: no run in --logdir=%s (%s)",
                                                         absl::GetFlag(FLAGS_logdir), text.status().message())
                                       : absl::StrFormat("--config: %s", text.status().message()));
  }
  return ParseRunConfig(*text, path);
}

// --threads, or what the cgroup's CPU quota gives.
absl::StatusOr<int> ThreadsFromFlags() {
  const int threads = absl::GetFlag(FLAGS_threads);
  if (threads < 0 || threads > 256) {
    return absl::InvalidArgumentError(absl::StrFormat("--threads=%d, want 0..256", threads));
  }
  return threads == 0 ? DefaultThreads() : threads;
}

}  // namespace

absl::StatusOr<Learner::Options> LearnerOptionsFromFlags() {
  Learner::Options options;
  options.logdir = absl::GetFlag(FLAGS_logdir);
  if (options.logdir.empty()) {
    return absl::InvalidArgumentError("--logdir is missing: the folder that the run is to be written to");
  }
  options.resume = Resuming();
  options.resume_from = absl::GetFlag(FLAGS_resume_from);
  if (!absl::GetFlag(FLAGS_resume) && !options.resume_from.empty()) {
    return absl::InvalidArgumentError("--resume_from wants --resume beside it");
  }
  options.init_from = absl::GetFlag(FLAGS_init_from);
  if (absl::GetFlag(FLAGS_resume) && !options.init_from.empty()) {
    return absl::InvalidArgumentError("--init_from begins a new run: leave --resume away, or --init_from");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(options.config, BaseConfig(options.resume));
  if (const auto agent = absl::GetFlag(FLAGS_agent)) options.config.set_agent(*agent);
  if (const auto env = absl::GetFlag(FLAGS_env)) options.config.mutable_env()->set_name(*env);
  if (const auto env = absl::GetFlag(FLAGS_eval_env)) options.config.mutable_eval()->set_env(*env);
  if (const auto steps = absl::GetFlag(FLAGS_steps)) options.config.set_steps(*steps);
  if (const auto seed = absl::GetFlag(FLAGS_seed)) options.config.set_seed(*seed);
  if (const auto lanes = absl::GetFlag(FLAGS_lanes)) options.config.set_lanes(*lanes);
  if (const auto cpu = absl::GetFlag(FLAGS_cpu)) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const v1::RunConfig::Cpu parsed, ParseCpu(*cpu));
    options.config.set_cpu(parsed);
  }
  v1::CheckpointConfig& checkpoint = *options.config.mutable_checkpoint();
  if (const auto every = absl::GetFlag(FLAGS_checkpoint_every)) checkpoint.set_every_iterations(*every);
  if (const auto keep = absl::GetFlag(FLAGS_keep_checkpoints)) checkpoint.set_keep(*keep);
  CRAFTFLEET_ASSIGN_OR_RETURN(options.texture_dir, TextureDir(absl::GetFlag(FLAGS_textures)));
  CRAFTFLEET_ASSIGN_OR_RETURN(options.threads, ThreadsFromFlags());
  CRAFTFLEET_ASSIGN_OR_RETURN(options.device, FindDevice(absl::GetFlag(FLAGS_device)));
  options.server = wire::ServerOptionsFromFlags(/*address=*/"");
  options.progress = &std::cout;
  options.progress_in_place = isatty(STDOUT_FILENO) == 1;
  return options;
}

}  // namespace craftfleet
