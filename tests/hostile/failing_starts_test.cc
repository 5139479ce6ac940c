// Starts that fail leave a run folder as it was.

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/test_paths.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// A loopback port that is in use by a listener that never answers.
class BusyPort {
 public:
  BusyPort() : descriptor_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    EXPECT_EQ(::bind(descriptor_, reinterpret_cast<sockaddr*>(&address), size), 0);
    EXPECT_EQ(::listen(descriptor_, 1), 0);
    EXPECT_EQ(::getsockname(descriptor_, reinterpret_cast<sockaddr*>(&address), &size), 0);
    name_ = absl::StrCat("127.0.0.1:", ntohs(address.sin_port));
  }
  ~BusyPort() { ::close(descriptor_); }
  BusyPort(const BusyPort&) = delete;
  BusyPort& operator=(const BusyPort&) = delete;
  const std::string& name() const { return name_; }

 private:
  const int descriptor_;
  std::string name_;
};

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

  const BusyPort busy_;
};

TEST_F(FailingStartsTest, NoFailingStartRemovesAnything) {
  Train("run");
  const std::string learner = "craftfleet-learner";
  const std::string free = "--listen=127.0.0.1:0";
  ExpectHarmless(learner, {"--listen=" + busy_.name()}, busy_.name());
  ExpectHarmless(learner, {free, "--metrics_listen=" + busy_.name()}, busy_.name());
  ExpectHarmless("craftfleet train", {"--listen=" + busy_.name()}, busy_.name());
  ExpectHarmless("craftfleet train", {"--metrics_listen=" + busy_.name()}, busy_.name());

  ASSERT_THAT(WriteFileSynced(folder_ / "access.txt", "rule { who: }"), IsOk());
  ExpectHarmless(learner, {free, "--access_file=" + folder_ / "access.txt"}, "access_file");
  ExpectHarmless(learner, {free, "--tls_cert=" + folder_ / "none.pem", "--tls_key=" + folder_ / "none.pem"},
                 "none.pem");
  ExpectHarmless(learner, {free, "--lanes=8"}, "lanes");

  const std::string textures = folder_ / "textures";
  std::filesystem::copy(BuiltProgram("../share/craftfleet/textures"), textures);
  std::filesystem::copy_file(textures + "/sand.png", textures + "/stone.png",
                             std::filesystem::copy_options::overwrite_existing);
  ExpectHarmless(learner, {free, "--textures=" + textures}, "was played with textures");

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
  const Ended ended = Run("craftfleet-learner", Flags("run", {"--listen=" + busy_.name()}));
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr(busy_.name()));
  EXPECT_THAT(Contents(), testing::IsEmpty());
  Train("run");
}

}  // namespace
}  // namespace craftfleet
