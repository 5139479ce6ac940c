// Starts that fail leave a run folder as it was.

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/loopback.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

class FailingStartsTest : public SmallRunTest {
 protected:
  // The bytes of each file of the run, except the lock, which names its last holder.
  std::map<std::string, std::string> Contents() const {
    std::map<std::string, std::string> contents;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(Logdir("run"))) {
      const std::string path = entry.path().string();
      if (path == Logdir("run") + "/lock") continue;
      contents[path] = entry.is_regular_file() ? ReadFile(path).value() : "folder";
    }
    return contents;
  }
  // Flags that go back to the first of three checkpoints, which would remove the others and most of the logs.
  void ExpectHarmless(const std::string& program, const std::vector<std::string>& more, const std::string& error) {
    std::vector<std::string> flags = {"--resume", "--resume_from=iter-00000001", "--logdir=" + Logdir("run")};
    flags.insert(flags.end(), more.begin(), more.end());
    const auto before = Contents();
    const Ended ended = Run(program, flags);
    EXPECT_EQ(ended.exit_code, 1) << ended.err;
    EXPECT_THAT(ended.err, HasSubstr(error));
    EXPECT_TRUE(Contents() == before) << error;
  }

  const LoopbackListener busy_;
};

TEST_F(FailingStartsTest, NoFailingStartRemovesAnything) {
  CopyTrained("run");
  const std::string learner = "craftfleet-learner";
  const std::string free = "--listen=127.0.0.1:0";
  ExpectHarmless(learner, {"--listen=" + busy_.address()}, busy_.address());
  ExpectHarmless(learner, {free, "--metrics_listen=" + busy_.address()}, busy_.address());
  ExpectHarmless("craftfleet train", {"--listen=" + busy_.address()}, busy_.address());
  ExpectHarmless("craftfleet train", {"--metrics_listen=" + busy_.address()}, busy_.address());

  ASSERT_THAT(WriteFileSynced(folder_ / "access.txt", "rule { who: }"), IsOk());
  ExpectHarmless(learner, {free, "--access_file=" + folder_ / "access.txt"}, "access_file");
  ExpectHarmless(learner, {free, "--tls_cert=" + folder_ / "none.pem", "--tls_key=" + folder_ / "none.pem"},
                 "none.pem");
  ExpectHarmless(learner, {free, "--lanes=8"}, "lanes");

  ExpectHarmless(learner, {free, "--textures=" + OtherTextures()}, "was played with textures");

  const std::string weights = Checkpoint("run", 1) + "/weights.safetensors";
  const std::string sound = ReadFile(weights).value();
  ASSERT_THAT(WriteFileSynced(weights, sound.substr(0, sound.size() / 2)), IsOk());
  ExpectHarmless(learner, {free}, "weights.safetensors");
  ASSERT_THAT(WriteFileSynced(weights, sound), IsOk());

  // The run can still be resumed.
  const auto before = Contents();
  const Ended ended = Run("craftfleet train", {"--resume", "--resume_from=iter-00000001", "--logdir=" + Logdir("run")});
  EXPECT_EQ(ended.exit_code, 0) << ended.err;
  for (const char* file : {"/stats.jsonl", "/checkpoints/iter-00000003/weights.safetensors"}) {
    EXPECT_TRUE(Contents().at(Logdir("run") + file) == before.at(Logdir("run") + file)) << file;
  }
}

TEST_F(FailingStartsTest, ANewRunThatCannotStartLeavesNoRun) {
  const std::string listen = "--listen=" + busy_.address();
  for (const Ended& ended :
       {Run("craftfleet-learner", Flags("run", {listen})), Run("craftfleet-envserver", {listen})}) {
    EXPECT_EQ(ended.exit_code, 1);
    EXPECT_THAT(ended.err, HasSubstr("cannot listen on " + busy_.address() + ": the port is in use"));
  }
  EXPECT_THAT(Contents(), testing::IsEmpty());
  Train("run");
}

// Its games could not be drawn: it waited for them for ever, or for those of its evaluation after all its steps.
TEST_F(FailingStartsTest, TexturesWithoutAVariantThatTheRunShowsAreRefused) {
  const std::string textures = OtherTextures();
  std::filesystem::remove(textures + "/tree0.png");
  for (const std::string flag : {"--env", "--eval_env"}) {
    const Ended ended =
        Run("craftfleet train", Flags("other", {flag + "=crafter:appearance=25/25/25/25", "--textures=" + textures}));
    EXPECT_EQ(ended.exit_code, 1);
    EXPECT_THAT(ended.err,
                HasSubstr("environment crafter:appearance=25/25/25/25: no texture " + textures + "/tree0.png"));
    EXPECT_FALSE(std::filesystem::exists(Logdir("other") + "/config.txt"));
  }
}

}  // namespace
}  // namespace craftfleet
