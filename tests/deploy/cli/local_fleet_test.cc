// A whole run on a device: play, updates, evaluations, checkpoints. On a stand-in for a GPU.

#include "deploy/cli/local_fleet.h"

#include <memory>
#include <ostream>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/device.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "common/io/paths.h"
#include "learner/run/checkpoint_store.h"
#include "tests/agent/stand_in_device.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Six short iterations with ends of episodes and evaluations; `more` is added to the configuration.
struct RunCase {
  const char* name;
  const char* more;
};
void PrintTo(const RunCase& run, std::ostream* out) { *out << run.name; }

struct Result {
  std::string episodes;
  std::string evaluations;
  std::string weights;
  std::string optimizer;
};

class DeviceRun : public testing::TestWithParam<RunCase> {
 protected:
  std::string Logdir(const std::string& run) const { return folder_ / run; }
  std::string Checkpoint(const std::string& run, int iteration) const {
    return JoinPath(Logdir(run), JoinPath("checkpoints", CheckpointName(iteration)));
  }

  std::unique_ptr<LocalFleet> Start(const std::string& run, bool resume) const {
    Learner::Options options;
    options.config = *ParseRunConfig(std::string(R"(
      steps: 768  lanes: 4  seed: 3  fragment_steps: 16  network { frame_size: 36 }  env { length: 40 }
      ppo { rollout_steps: 128  minibatch_size: 32  epochs: 1 }
      checkpoint { every_iterations: 1  keep: 20 }
      eval { every_steps: 300  episodes: 1  final_episodes: 1 } )") +
                                         GetParam().more,
                                     "config.txt");
    options.device = kStandInDevice;
    EXPECT_THAT(SetRunDevice(options.device, /*resumed=*/false, v1::RunConfig::CUDA, &options.config), IsOk());
    options.texture_dir = *TextureDir("");
    options.logdir = Logdir(run);
    options.resume = resume;
    auto fleet = LocalFleet::Create(options);
    EXPECT_THAT(fleet, IsOk());
    return fleet.ok() ? *std::move(fleet) : nullptr;
  }

  Result Read(const std::string& run) const {
    const auto file = [](const std::string& folder, const std::string& name) {
      return ReadFile(JoinPath(folder, name)).value_or("none");
    };
    const std::string logdir = Logdir(run);
    const std::string last = Checkpoint(run, 6);
    return {file(logdir, "stats.jsonl"), file(logdir, "eval_sampled.jsonl") + file(logdir, "final_argmax.jsonl"),
            file(last, "weights.safetensors"), file(last, "optimizer.safetensors")};
  }

  const TempFolder folder_;
};

TEST_P(DeviceRun, PlaysAndLearnsThereAndGoesOnAfterAStopAsIfNeverStopped) {
  const DeviceTraffic before = TrafficSoFar();
  const auto whole = Start("whole", /*resume=*/false);
  ASSERT_NE(whole, nullptr);
  EXPECT_THAT(whole->Run(), IsOk());
  EXPECT_GT(TrafficSoFar().computed - before.computed, 1000);
  const Result expected = Read("whole");
  EXPECT_THAT(expected.episodes, HasSubstr("\"length\": 40,"));
  EXPECT_THAT(expected.evaluations, HasSubstr("\"length\": 40,"));
  EXPECT_NE(expected.weights, "none");

  {
    const auto first = Start("stopped", /*resume=*/false);
    ASSERT_NE(first, nullptr);
    std::thread stop([&] {
      EXPECT_TRUE(WaitUntil([&] { return PathExists(Checkpoint("stopped", 1)); }));
      first->Stop();
    });
    EXPECT_THAT(first->Run(), IsOk());
    stop.join();
    ASSERT_FALSE(PathExists(Checkpoint("stopped", 6))) << "it ended before the stop";
  }
  const auto second = Start("stopped", /*resume=*/true);
  ASSERT_NE(second, nullptr);
  EXPECT_THAT(second->Run(), IsOk());
  const Result actual = Read("stopped");
  EXPECT_EQ(actual.episodes, expected.episodes);
  EXPECT_EQ(actual.evaluations, expected.evaluations);
  EXPECT_TRUE(actual.weights == expected.weights);
  EXPECT_TRUE(actual.optimizer == expected.optimizer);
}

INSTANTIATE_TEST_SUITE_P(All, DeviceRun,
                         testing::Values(RunCase{"ppo_cnn", R"(agent: "ppo_cnn")"},
                                         RunCase{"overlapped", R"(agent: "ppo_cnn" overlap: 1)"},
                                         RunCase{"lstm_cnn", R"(agent: "lstm_cnn")"},
                                         RunCase{"grid_distillation", R"(agent: "grid_distillation"
                                                      distillation { every_iterations: 2 epochs: 1 })"}),
                         [](const testing::TestParamInfo<RunCase>& info) { return info.param.name; });

}  // namespace
}  // namespace craftfleet
