#include "learner/run_flags.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <cstdint>
#include <iostream>
#include <optional>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/agent/device.h"
#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "common/io/paths.h"
#include "common/process/cgroup.h"
#include "common/process/cpu_pin.h"
#include "common/process/flag_values.h"
#include "common/process/shared_flags.h"
#include "common/wire/wire_flags.h"
#include "learner/run/checkpoint_store.h"
#include "learner/runnable_config.h"

ABSL_FLAG(std::optional<std::string>, agent, std::nullopt, "agent to train; craftfleet agents lists them [ppo_cnn]");
ABSL_FLAG(std::optional<std::string>, eval_env, std::nullopt,
          "environment of the evaluation episodes, such as crafter:appearance=0/33/33/34 [as --env]");
ABSL_FLAG(std::optional<craftfleet::Count>, steps, std::nullopt,
          "environment steps to train for, all lanes together: 1000000, 1e6 or 1M\n"
          "rounded up to whole iterations of ppo.rollout_steps (4096 by default)\n"
          "[1000000]");
ABSL_FLAG(std::optional<std::string>, cpu, std::nullopt,
          "instruction set for the numerics of every process of the run: native, avx2 or avx512\n"
          "native is the best of each CPU. CPUs of different kinds compute equal bytes only with the same setting\n"
          "[native]");
ABSL_FLAG(std::optional<int32_t>, lanes, std::nullopt, "games played side by side [16]");
ABSL_FLAG(
    std::optional<int32_t>, overlap, std::nullopt,
    "1: play the next iteration while the update is computed, with the weights from before it; 0: play waits [0]");
ABSL_FLAG(std::optional<int32_t>, max_staleness, std::nullopt,
          "1..64: play and updates do not wait for each other; fragments are at most this many updates old\n"
          "0: they wait [0]");
ABSL_FLAG(bool, resume, false,
          "resume the run in --logdir from its newest checkpoint, as if it had never stopped\n"
          "only --steps and the checkpoint settings may change");
ABSL_FLAG(bool, autoresume, false,
          "as --resume if --logdir has a checkpoint, otherwise start a new run\n"
          "for supervisors that restart the same command when it ends");
ABSL_FLAG(std::string, resume_from, "",
          "with --resume: the checkpoint to resume from, such as iter-00000020 [the newest]");
ABSL_FLAG(std::string, init_from, "",
          "start a new run with the weights of another run: its folder (newest checkpoint) or a checkpoint\n"
          "of the same agent; optimiser, counters and everything else start from zero\n"
          "but for the statistics of normalised values");
ABSL_FLAG(std::optional<int32_t>, checkpoint_every, std::nullopt,
          "iterations from one checkpoint to the next; one is always written at the end [10]");
ABSL_FLAG(std::optional<int32_t>, keep_checkpoints, std::nullopt,
          "number of newest checkpoints to keep, in addition to the best one [3]");
ABSL_FLAG(std::string, config, "",
          "file with the run's configuration in protobuf text format, such as another run's config.txt\n"
          "other flags override its values");
ABSL_FLAG(craftfleet::GivenAddress, http_listen, {},
          "address to serve the live page on, HOST:PORT, for browsers; empty: none\n"
          "beyond this host it requires --tls_cert, --tls_key and --access_file with the tokens of its readers\n"
          "[any free port of this host, see the log; craftfleet train, and learners with TLS: none]");
ABSL_FLAG(std::vector<std::string>, http_hosts, {},
          "names under which browsers reach the live page besides localhost, joined by commas\n"
          "such as that of a proxy (jupyter.example.com); without --access_file other names are refused");

namespace craftfleet {
namespace {

// Of standard output; 80 if the terminal does not report its size.
int TerminalColumns() {
  winsize size = {};
  return ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

// Errors as FindCheckpoint, but for NotFound.
absl::StatusOr<bool> Resuming() {
  if (absl::GetFlag(FLAGS_resume)) return true;
  if (!absl::GetFlag(FLAGS_autoresume)) return false;
  const absl::Status found = FindCheckpoint(absl::GetFlag(FLAGS_logdir)).status();
  if (absl::IsNotFound(found)) return false;
  CRAFTFLEET_RETURN_IF_ERROR(found);
  return true;
}

absl::StatusOr<v1::RunConfig> BaseConfig(bool resume) {
  const std::string config = absl::GetFlag(FLAGS_config);
  std::string path;
  absl::StatusOr<std::string> text("");
  if (resume) {  // also with --config: a run that is not there has no configuration
    const std::string logdir = absl::GetFlag(FLAGS_logdir);
    path = JoinPath(logdir, "config.txt");
    text = WithPrefix(FindCheckpoint(logdir).ok()
                          ? "--resume: the run has checkpoints; put back the configuration that it was started with"
                          : absl::StrFormat("--resume: no run in --logdir=%s; start it without --resume", logdir),
                      ReadFile(path));
  }
  if (text.ok() && !config.empty()) {
    path = config;
    text = WithPrefix("--config", ReadFile(path));
  }
  CRAFTFLEET_RETURN_IF_ERROR(text.status());
  return ParseRunConfig(*text, path);
}

// Sets the fields that flags were given for.
absl::Status ApplyFlags(v1::RunConfig* config) {
  if (const auto agent = absl::GetFlag(FLAGS_agent)) config->set_agent(*agent);
  if (const auto env = absl::GetFlag(FLAGS_env)) config->mutable_env()->set_name(*env);
  if (const auto env = absl::GetFlag(FLAGS_eval_env)) config->mutable_eval()->set_env(*env);
  if (const auto steps = absl::GetFlag(FLAGS_steps)) config->set_steps(steps->value);
  if (const auto seed = absl::GetFlag(FLAGS_seed)) config->set_seed(*seed);
  if (const auto lanes = absl::GetFlag(FLAGS_lanes)) config->set_lanes(*lanes);
  if (const auto overlap = absl::GetFlag(FLAGS_overlap)) config->set_overlap(*overlap);
  if (const auto staleness = absl::GetFlag(FLAGS_max_staleness)) config->set_max_staleness(*staleness);
  if (const auto cpu = absl::GetFlag(FLAGS_cpu)) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const v1::RunConfig::Cpu parsed, ParseCpu(*cpu));
    config->set_cpu(parsed);
  }
  v1::CheckpointConfig& checkpoint = *config->mutable_checkpoint();
  if (const auto every = absl::GetFlag(FLAGS_checkpoint_every)) checkpoint.set_every_iterations(*every);
  if (const auto keep = absl::GetFlag(FLAGS_keep_checkpoints)) checkpoint.set_keep(*keep);
  return absl::OkStatus();
}

// `of_cpu_run`: for a run that began on the CPU, which `auto` does not leave.
absl::StatusOr<std::string> DeviceFromFlag(bool of_cpu_run) {
  const std::string name = absl::GetFlag(FLAGS_device);
  return FindDevice(of_cpu_run && name == "auto" ? "cpu" : name);
}

}  // namespace

absl::StatusOr<int> ThreadsFromFlags() {
  const int threads = absl::GetFlag(FLAGS_threads);
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("threads", threads, 0, 256));
  return threads == 0 ? DefaultThreads() : threads;
}

absl::Status CheckRankDevice() {
  const std::string device = absl::GetFlag(FLAGS_device);
  if (device == "auto" || device == "cpu") return absl::OkStatus();
  return InvalidFlag("device", device, "cpu: several learners compute on CPUs only");
}

absl::Status CheckSameAsFlags(const v1::RunConfig& config) {
  v1::RunConfig own = config;
  if (!absl::GetFlag(FLAGS_config).empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(own, BaseConfig(/*resume=*/false));
    if (config.has_device()) own.set_device(config.device());
  }
  CRAFTFLEET_RETURN_IF_ERROR(ApplyFlags(&own));
  CRAFTFLEET_ASSIGN_OR_RETURN(own, CompleteConfig(std::move(own)));
  const std::string differences = Differences(config, own);
  if (differences.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("its flags ask for another configuration than rank 0's: ", differences));
}

absl::StatusOr<Learner::Options> LearnerOptionsFromFlags(v1::RunConfig::Device on_gpu,
                                                         absl::string_view page_by_default) {
  Learner::Options options;
  options.logdir = absl::GetFlag(FLAGS_logdir);
  if (options.logdir.empty()) {
    return absl::InvalidArgumentError("--logdir is missing: the folder to write the run to");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(options.resume, Resuming());
  options.resume_from = absl::GetFlag(FLAGS_resume_from);
  if (!absl::GetFlag(FLAGS_resume) && !options.resume_from.empty()) {
    return absl::InvalidArgumentError("--resume_from requires --resume");
  }
  options.init_from = absl::GetFlag(FLAGS_init_from);
  if (absl::GetFlag(FLAGS_resume) && !options.init_from.empty()) {
    return absl::InvalidArgumentError("--init_from starts a new run and cannot be combined with --resume");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(options.config, BaseConfig(options.resume));
  CRAFTFLEET_RETURN_IF_ERROR(ApplyFlags(&options.config));
  CRAFTFLEET_ASSIGN_OR_RETURN(options.texture_dir, TextureDir(absl::GetFlag(FLAGS_textures)));
  CRAFTFLEET_ASSIGN_OR_RETURN(options.threads, ThreadsFromFlags());
  CRAFTFLEET_ASSIGN_OR_RETURN(options.device, DeviceFromFlag(options.resume && !options.config.has_device()));
  CRAFTFLEET_RETURN_IF_ERROR(SetRunDevice(options.device, options.resume, on_gpu, &options.config));
  SetUpDevice(options.device, options.config.precision());
  options.server = wire::ServerOptionsFromFlags(/*address=*/"");
  options.http_address = absl::GetFlag(FLAGS_http_listen)
                             .address.value_or(options.server.files.empty() ? std::string(page_by_default) : "");
  options.http_hosts = absl::GetFlag(FLAGS_http_hosts);
  options.progress = &std::cout;
  if (isatty(STDOUT_FILENO) == 1) options.progress_columns = TerminalColumns;
  return options;
}

}  // namespace craftfleet
