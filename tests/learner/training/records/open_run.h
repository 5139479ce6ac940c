// A run folder after Begin, for tests of the trainer's files.

#pragma once

#include <memory>
#include <string>

#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/run_folder.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {

class OpenRun : public testing::Test {
 protected:
  OpenRun() {
    run_ = RunFolder::Create(logdir_, ResolveRunConfig(DefaultRunConfig()).value(), "digest1", &clock_).value();
    EXPECT_THAT(run_->Begin(), IsOk());
  }
  // The text of a file of the run; "none" if there is no such file.
  std::string Text(const std::string& name) const { return ReadFile(JoinPath(logdir_, name)).value_or("none"); }
  // Lets another learner take over the folder.
  void TakeOver() {
    EpochFence other;
    ASSERT_THAT(other.Take(logdir_, run_->epoch() + 1), IsOk());
  }

  const TempFolder temp_;
  const std::string logdir_ = temp_ / "run";
  FakeClock clock_;
  std::unique_ptr<RunFolder> run_;
};

}  // namespace craftfleet
