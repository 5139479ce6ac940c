// Replaces craftfleet-train: accepts its flags and writes its checkpoints without training. FAKE_TRAIN selects the
// behaviour: "": finishes; "half": ends after half of the steps; "wait": the same, but waits for SIGTERM; "fail2": seed
// 2 fails. Each start appends its arguments to <logdir>/starts.

#include <signal.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <ios>
#include <map>
#include <string>

#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>
#include <absl/strings/strip.h>

#include "common/base/check.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/checkpoint_store.h"
#include "learner/run/folder_lock.h"

namespace craftfleet {
namespace {

v1::RunConfig ConfigOf(const std::map<std::string, std::string>& flags, const std::string& logdir) {
  const std::string path = flags.count("config") > 0 ? flags.at("config") : JoinPath(logdir, "config.txt");
  v1::RunConfig config = ResolveRunConfig(ParseRunConfig(ReadFile(path).value(), path).value()).value();
  if (flags.count("seed") > 0) config.set_seed(std::stoul(flags.at("seed")));
  config.set_steps(std::stol(flags.at("steps")));
  return config;
}

void WriteRunCheckpoint(const std::string& logdir, const v1::RunConfig& config, int64_t steps, bool evaluated) {
  Checkpoint checkpoint;
  *checkpoint.state.mutable_config() = config;
  checkpoint.state.set_iteration(steps / config.ppo().rollout_steps());
  checkpoint.state.set_env_steps(steps);
  checkpoint.state.set_final_evaluation_steps(evaluated ? steps : 0);
  for (int lane = 0; lane < config.lanes(); ++lane) checkpoint.state.add_lanes();
  CRAFTFLEET_CHECK(CheckpointStore::Open(JoinPath(logdir, "checkpoints")).value().Write(checkpoint).ok());
}

int Run(const std::map<std::string, std::string>& flags, const std::string& line) {
  const char* given = std::getenv("FAKE_TRAIN");
  const std::string mode = given == nullptr ? "" : given;
  const std::string& logdir = flags.at("logdir");
  std::ofstream(JoinPath(logdir, "starts"), std::ios::app) << line << "\n";
  const absl::StatusOr<FolderLock> lock = FolderLock::Acquire(logdir);
  if (!lock.ok()) return 1;
  const v1::RunConfig config = ConfigOf(flags, logdir);
  if (mode == "fail2" && config.seed() == 2) {
    std::puts("the last line says why\n");
    return 3;
  }
  CRAFTFLEET_CHECK(ReplaceFile(JoinPath(logdir, "config.txt"), FormatRunConfig(config)).ok());
  const bool half = mode == "half" || mode == "wait";
  WriteRunCheckpoint(logdir, config, half ? config.steps() / 2 : config.steps(), !half);
  if (mode == "wait") {
    sigset_t signals;
    sigemptyset(&signals);
    sigaddset(&signals, SIGTERM);
    int signal = 0;
    sigwait(&signals, &signal);
  }
  return 0;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigprocmask(SIG_BLOCK, &signals, nullptr);  // kept for sigwait
  std::map<std::string, std::string> flags;
  std::string line;
  for (int i = 1; i < argc; ++i) {
    const std::pair<std::string, std::string> flag =
        absl::StrSplit(absl::StripPrefix(argv[i], "--"), absl::MaxSplits('=', 1));
    flags.insert(flag);
    line += std::string(argv[i]) + " ";
  }
  return craftfleet::Run(flags, line);
}
