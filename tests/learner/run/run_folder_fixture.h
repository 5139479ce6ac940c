// A run folder that is created and resumed, for its tests.

#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/run_folder.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {

class RunFolderTest : public testing::Test {
 protected:
  std::unique_ptr<RunFolder> Create() {
    v1::RunConfig config = ResolveRunConfig(DefaultRunConfig()).value();
    config.mutable_checkpoint()->set_every_iterations(every_iterations_);
    auto folder = RunFolder::Create(logdir_, config, texture_digest_, &clock_);
    EXPECT_THAT(folder, IsOk());
    if (!folder.ok()) return nullptr;
    EXPECT_THAT((*folder)->Begin(), IsOk());
    return *std::move(folder);
  }
  absl::StatusOr<ResumedRun> Look(const std::string& from = "") {
    return RunFolder::Resume(logdir_, from, texture_digest_, &clock_);
  }
  absl::StatusOr<ResumedRun> Resume(const std::string& from = "") {
    absl::StatusOr<ResumedRun> run = Look(from);
    EXPECT_TRUE(!run.ok() || run->folder->Begin().ok());
    return run;
  }
  // The content of each file except `lock`, which names its last holder.
  std::map<std::string, std::string> Contents() const {
    std::map<std::string, std::string> contents;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(logdir_)) {
      const std::string path = entry.path().string();
      if (path != logdir_ + "/lock") contents[path] = entry.is_regular_file() ? ReadFile(path).value() : "folder";
    }
    return contents;
  }

  // A run of two iterations with a checkpoint after each, then some logs that are in no checkpoint.
  void MakeRun() {
    auto folder = Create();
    for (int64_t iteration = 1; iteration <= 3; ++iteration) {
      folder->AddEpisodes({SampleEpisode(100 * iteration, 1.0 * iteration), SampleEpisode(10, 0)});
      folder->AddScalars(4096 * iteration, {{"train/reward", 1.0 * iteration}});
      ASSERT_THAT(folder->FlushLogs(), IsOk());
      if (iteration == 3) break;
      ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(iteration)), IsOk());
    }
  }

  int every_iterations_ = 1;  // a checkpoint is periodic
  const TempFolder temp_;
  const std::string logdir_ = temp_ / "runs/a";
  const std::string texture_digest_ = "digest1";
  FakeClock clock_;
};

}  // namespace craftfleet
