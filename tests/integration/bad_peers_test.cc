// Peers that are unreachable, late, of the wrong kind, or send garbage.

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/fakes/test_paths.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr absl::Duration kSoon = absl::Seconds(5);  // within which errors must be reported

class BadPeersTest : public SmallRunTest {
 protected:
  // An unused address.
  std::string Address(const std::string& name) const { return "unix:" + (folder_ / name); }

  std::unique_ptr<Process> StartLearner(const std::string& run, const std::string& address) {
    return Start("craftfleet-learner", Flags(run, {"--listen=" + address}));
  }
  std::unique_ptr<Process> StartServer(const std::string& address, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"--listen=" + address};
    arguments.insert(arguments.end(), more.begin(), more.end());
    auto server = Start("craftfleet-envserver", arguments);
    EXPECT_THAT(server->WaitForAddress("listening on ", kPatience), IsOk());
    return server;
  }
  std::unique_ptr<Process> StartActor(const std::string& learner, const std::string& servers) {
    return Start("craftfleet-actor", {"--learner=" + learner, "--envservers=" + servers});
  }
  void ExpectToFinish(Process* process) {
    const Ended ended = Finish(process);
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
  }
  // Expects the run to complete, and the process to end soon after that.
  void ExpectToComplete(Process* learner) {
    EXPECT_TRUE(learner->WaitForText("the run is complete", kPatience)) << learner->Err();
    EXPECT_EQ(learner->Wait(kSoon), 0) << learner->Err();
  }
};

TEST_F(BadPeersTest, APortInUseIsNamedAndLeavesNoFiles) {
  const auto server = Start("craftfleet-envserver", {"--listen=127.0.0.1:0"});
  const std::string address = server->WaitForAddress().value();
  Ended ended = Run("craftfleet-envserver", {"--listen=" + address});
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("cannot listen on " + address + ": the port is in use"));
  ended = Run("craftfleet-learner", Flags("run", {"--listen=" + address}));
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("cannot listen on " + address));
  Train("run");  // the same folder
}

TEST_F(BadPeersTest, AnActorWaitsForItsLearner) {
  const auto server = StartServer(Address("server"));
  const auto actor = StartActor(Address("learner"), Address("server"));
  EXPECT_TRUE(actor->WaitForText("warning: learner " + Address("learner") + ": ", kSoon)) << actor->Err();
  EXPECT_TRUE(actor->WaitForText("trying again until it answers", kSoon)) << actor->Err();
  const auto learner = StartLearner("run", Address("learner"));
  ExpectToComplete(learner.get());
  ExpectToFinish(actor.get());
}

TEST_F(BadPeersTest, AnActorWaitsForItsEnvironmentServer) {
  const auto learner = StartLearner("run", Address("learner"));
  const auto actor = StartActor(Address("learner"), Address("server"));
  EXPECT_TRUE(actor->WaitForText("joined run", kPatience)) << actor->Err();
  EXPECT_TRUE(actor->WaitForText("warning: environment server " + Address("server") + ": ", kSoon)) << actor->Err();
  const auto server = StartServer(Address("server"));
  ExpectToComplete(learner.get());
  ExpectToFinish(actor.get());
}

TEST_F(BadPeersTest, AnActorPlaysOnTheAvailableServers) {
  const auto server = StartServer(Address("server"));
  const auto learner = StartLearner("run", Address("learner"));
  const auto actor = StartActor(Address("learner"), Address("away") + "," + Address("server"));
  ExpectToComplete(learner.get());
  EXPECT_THAT(actor->Err(), HasSubstr("environment server " + Address("away")));
}

TEST_F(BadPeersTest, AnEnvironmentServerIsNotALearner) {
  const auto server = StartServer(Address("server"));
  const Ended ended = Finish(StartActor(Address("server"), Address("server")).get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("learner " + Address("server") + ": does not know this call"));
}

TEST_F(BadPeersTest, ALearnerIsNotAnEnvironmentServer) {
  const auto learner = StartLearner("run", Address("learner"));
  const Ended ended = Finish(StartActor(Address("learner"), Address("learner")).get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("environment server " + Address("learner") + ": does not know this call"));
}

TEST_F(BadPeersTest, DifferentTexturesAreDetected) {
  const std::string textures = folder_ / "textures";
  std::filesystem::copy(BuiltProgram("../share/craftfleet/textures"), textures);
  std::filesystem::copy_file(textures + "/sand.png", textures + "/stone.png",
                             std::filesystem::copy_options::overwrite_existing);
  const auto server = StartServer(Address("server"), {"--textures=" + textures});
  const auto learner = StartLearner("run", Address("learner"));
  const Ended ended = Finish(StartActor(Address("learner"), Address("server")).get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("environment server " + Address("server")));
  EXPECT_THAT(ended.err, HasSubstr("give both the same --textures"));
}

// The actor used to end: any client could keep a run without actors by claiming its environment servers.
TEST_F(BadPeersTest, AServerThatPlaysForAnotherRunReportsItAndIsWaitedFor) {
  const auto server = StartServer(Address("server"));
  const auto first = StartLearner("first", Address("first-learner"));
  const auto first_actor = StartActor(Address("first-learner"), Address("server"));
  const auto second = StartLearner("second", Address("second-learner"));
  // Suspend it within its run, so that its session stays open.
  ASSERT_TRUE(first_actor->WaitForText("joined run", kPatience));
  while (Run("craftfleet status", {"--address=" + Address("server")}).out.find("actor") == std::string::npos) {
    ASSERT_EQ(first->Wait(absl::ZeroDuration()), std::nullopt) << "the run ended too early";
  }
  first->Signal(SIGSTOP);
  const auto second_actor = StartActor(Address("second-learner"), Address("server"));
  EXPECT_TRUE(second_actor->WaitForText("this environment server serves run ", kPatience));
  EXPECT_TRUE(second_actor->WaitForText("wait until the other run ends", kPatience));
  first->Signal(SIGCONT);
  ExpectToComplete(first.get());
  ExpectToComplete(second.get());
}

TEST_F(BadPeersTest, StatusShowsTheProcess) {
  const auto server = StartServer(Address("server"));
  const auto learner = StartLearner("run", Address("learner"));
  ASSERT_THAT(learner->WaitForAddress("listening on ", kPatience), IsOk());
  for (const std::string role : {"learner", "server"}) {
    const Ended ended = Run("craftfleet status", {"--address=" + Address(role), "--json"});
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
    const auto json = nlohmann::json::parse(ended.out, nullptr, /*allow_exceptions=*/false);
    ASSERT_TRUE(json.is_object()) << ended.out;
    EXPECT_EQ(json["role"], role == "learner" ? "learner" : "envserver");
    EXPECT_GT(json["metrics"].size(), 3);
  }
}

TEST_F(BadPeersTest, StatusOfAProcessThatDoesNotAnswerEndsWithinSeconds) {
  const auto server = StartServer(Address("server"));
  server->Signal(SIGSTOP);
  const absl::Time start = absl::Now();
  const Ended ended = Run("craftfleet status", {"--address=" + Address("server")});
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr(Address("server") + ": cannot connect: "));
  EXPECT_LT(absl::Now() - start, absl::Seconds(8));
}

// Connects and writes `bytes`, and ignores any answer.
void SendBytes(const std::string& path, const std::string& bytes) {
  const int connection = socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un name = {};
  name.sun_family = AF_UNIX;
  path.copy(name.sun_path, sizeof(name.sun_path) - 1);
  ASSERT_EQ(connect(connection, reinterpret_cast<const sockaddr*>(&name), sizeof(name)), 0);
  EXPECT_GT(send(connection, bytes.data(), bytes.size(), MSG_NOSIGNAL), 0);
  close(connection);
}

TEST_F(BadPeersTest, GarbageOnThePortIsHarmless) {
  const auto server = StartServer(Address("server"));
  const auto learner = StartLearner("run", Address("learner"));
  ASSERT_THAT(learner->WaitForAddress("listening on ", kPatience), IsOk());
  std::mt19937 random(7);
  for (int i = 0; i < 50; ++i) {
    std::string bytes = i % 2 == 0 ? "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" : "GET / HTTP/1.1\r\n\r\n";
    for (int j = 0; j < 1000; ++j) bytes.push_back(static_cast<char>(random() % 256));
    SendBytes(folder_ / "learner", bytes);
    SendBytes(folder_ / "server", bytes);
  }
  const auto actor = StartActor(Address("learner"), Address("server"));
  ExpectToComplete(learner.get());
  EXPECT_EQ(server->Wait(absl::ZeroDuration()), std::nullopt);
}

}  // namespace
}  // namespace craftfleet
