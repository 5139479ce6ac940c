// Helpers for tests with real programs, and a run that ends within seconds.

#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/time/time.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_paths.h"
#include "tests/integration/process.h"

namespace craftfleet {

// The result of a program.
struct Ended {
  int exit_code = -1;  // -1: killed after a timeout
  std::string out;
  std::string err;
};

class SmallRunTest : public testing::Test {
 protected:
  // Three iterations of 64 steps on 4 lanes, with a checkpoint after each.
  static constexpr char kConfig[] = R"(
    steps: 192  lanes: 4  seed: 3  fragment_steps: 16
    env { length: 20 }
    ppo { rollout_steps: 64  minibatch_size: 32  epochs: 1 }
    checkpoint { every_iterations: 1  keep: 20 }
    eval { every_steps: 0  final_episodes: 0 }
  )";

  SmallRunTest() { EXPECT_THAT(WriteFileSynced(config(), kConfig), IsOk()); }

  std::string config() const { return folder_ / "config.txt"; }
  std::string Logdir(const std::string& run) const { return folder_ / run; }
  std::string Checkpoint(const std::string& run, int iteration) const {
    return JoinPath(Logdir(run), "checkpoints/iter-0000000" + std::to_string(iteration));
  }
  // A file of the run.
  std::string Text(const std::string& run, const std::string& file) const {
    return ReadFile(JoinPath(Logdir(run), file)).value_or("none");
  }
  // The flags of the small run.
  std::vector<std::string> Flags(const std::string& run, const std::vector<std::string>& more = {}) const {
    std::vector<std::string> flags = {"--config=" + config(), "--logdir=" + Logdir(run)};
    flags.insert(flags.end(), more.begin(), more.end());
    return flags;
  }

  std::unique_ptr<Process> Start(const std::string& program, const std::vector<std::string>& arguments) {
    auto process = Process::Start(program, arguments, folder_ / ("process-" + std::to_string(++processes_)));
    EXPECT_THAT(process, IsOk());
    return process.ok() ? *std::move(process) : nullptr;
  }
  Ended Run(const std::string& program, const std::vector<std::string>& arguments) {
    return Finish(Start(program, arguments).get());
  }
  static Ended Finish(Process* process) {
    const int exit_code = process->Wait(kPatience).value_or(-1);
    return {exit_code, process->Out(), process->Err()};
  }
  // Trains the small run in one process.
  void Train(const std::string& run) {
    const Ended ended = Run("craftfleet train", Flags(run));
    ASSERT_EQ(ended.exit_code, 0) << ended.err;
  }

  // Likewise, or copies such a run that an earlier call has trained with the same configuration.
  void CopyTrained(const std::string& run) {
    std::unique_ptr<TempFolder>& trained = trained_[ReadFile(config()).value()];
    if (trained == nullptr) {
      ASSERT_NO_FATAL_FAILURE(Train(run));
      trained = std::make_unique<TempFolder>();
      std::filesystem::copy(Logdir(run), *trained / "run", std::filesystem::copy_options::recursive);
    } else {
      std::filesystem::copy(*trained / "run", Logdir(run), std::filesystem::copy_options::recursive);
    }
  }

  // A folder with textures of which one differs from the installed ones.
  std::string OtherTextures() const {
    const std::string textures = folder_ / "textures";
    std::filesystem::copy(BuiltProgram("../share/craftfleet/textures"), textures);
    std::filesystem::copy_file(textures + "/sand.png", textures + "/stone.png",
                               std::filesystem::copy_options::overwrite_existing);
    return textures;
  }

  const TempFolder folder_;
  int processes_ = 0;
  static inline std::map<std::string, std::unique_ptr<TempFolder>> trained_;  // by configuration
};

}  // namespace craftfleet
