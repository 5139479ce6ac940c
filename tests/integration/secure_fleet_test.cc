// A fleet under attack: wrong credentials, garbage and new rights do not change the run's result.

#include <sys/socket.h>
#include <unistd.h>

#include <csignal>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <grpcpp/completion_queue.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/generic/generic_stub.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "tests/fakes/loopback.h"
#include "tests/fakes/sanitizers.h"
#include "tests/fakes/test_certificates.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

// A fleet with TLS and rights.
class SecureFleetTest : public FleetRunTest {
 protected:
  SecureFleetTest() {
    for (const char* name : {"learner", "envserver", "actor", "monitor"}) ca_.Issue(name, {name});
    EXPECT_THAT(WriteFileSynced(folder_ / "access.txt", R"(
                  client { name: "workers" certificate: "actor*" right: PLAY }
                  client { name: "servers" certificate: "envserver" right: SERVE }
                  client { name: "monitor" certificate: "monitor" right: WATCH })"),
                IsOk());
  }

  // Flags of a process that presents certificate `name`.
  std::vector<std::string> Tls(const std::string& name, const std::vector<std::string>& more = {}) const {
    std::vector<std::string> flags = {"--tls_cert=" + (folder_ / (name + ".pem")),
                                      "--tls_key=" + (folder_ / (name + ".key")), "--tls_ca=" + (folder_ / "ca.pem")};
    flags.insert(flags.end(), more.begin(), more.end());
    return flags;
  }

  void StartSecureLearner(const std::string& run, std::vector<std::string> more = {}) {
    more.push_back(access_flag_);
    learner_ = StartLearner(run, "127.0.0.1:0", Tls("learner", more));
    learner_address_ = learner_->WaitForAddress("listening on ", kPatience).value();
  }
  // A learner, an environment server that registers with it, and an actor. `more`: flags of the first two.
  void StartFleet(const std::string& run, std::vector<std::string> more = {}) {
    StartSecureLearner(run, more);
    more.insert(more.end(), {access_flag_, "--listen=127.0.0.1:0", "--learner=" + learner_address_});
    server_ = Start("craftfleet-envserver", run + "-server", Tls("envserver", more));
    actor_ =
        Start("craftfleet-actor", run + "-actor",
              Tls("actor", {access_flag_, "--learner=" + learner_address_, "--envservers=learner", "--threads=2"}));
  }
  void ExpectTheRunToEndLikeQuiet(const std::string& run) {
    EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
    EXPECT_EQ(actor_->Wait(absl::Seconds(10)), 0) << actor_->Err();
    ExpectLikeQuiet(run);
    EXPECT_EQ(server_->Wait(absl::ZeroDuration()), std::nullopt) << server_->Err();
  }

  // Runs `program`, expects it to fail, and returns its standard error.
  std::string Fail(const std::string& program, const std::vector<std::string>& flags) {
    const auto process = Start(program, absl::StrCat("intruder-", ++intruders_), flags);
    EXPECT_EQ(process->Wait(kPatience), 1);
    return process->Err();
  }

  const TempFolder folder_;
  const std::string access_flag_ = "--access_file=" + (folder_ / "access.txt");
  TestAuthority ca_{folder_, "ca"};
  std::unique_ptr<Process> learner_;
  std::unique_ptr<Process> server_;
  std::unique_ptr<Process> actor_;
  std::string learner_address_;
  int intruders_ = 0;
};

TEST_F(SecureFleetTest, StrangersAreRefusedAndTheRunIsTheSame) {
  StartFleet("strangers");
  WaitForCheckpoint("strangers", 2);

  const std::string address = "--address=" + learner_address_;
  EXPECT_THAT(Fail("craftfleet status", {address, "--tls_ca=" + (folder_ / "ca.pem")}),
              HasSubstr("give --tls_cert and --tls_key"));
  EXPECT_THAT(Fail("craftfleet status", Tls("actor", {address})), HasSubstr("no right to this"));
  EXPECT_THAT(Fail("craftfleet-actor", Tls("monitor", {"--learner=" + learner_address_, "--envservers=learner"})),
              AllOf(HasSubstr("learner " + learner_address_ + ": not allowed"), HasSubstr("no right to this")));
  EXPECT_THAT(Fail("craftfleet admin", Tls("monitor", {address, "stop"})),
              AllOf(HasSubstr("not allowed"), HasSubstr("no right to this")));
  EXPECT_EQ(Start("craftfleet status", "watcher", Tls("monitor", {address}))->Wait(kPatience), 0);

  EXPECT_THAT(learner_->Err(), AllOf(HasSubstr("gRPC: Handshake failed"),
                                     HasSubstr("refused /craftfleet.v1.StatusService/GetStatus: craftfleet@"),
                                     HasSubstr("it is \"monitor\" in the access file, without the right to play"),
                                     HasSubstr("it is \"monitor\" in the access file, without the right to steer"),
                                     HasSubstr("it is \"workers\" in the access file, without the right to watch")));
  ExpectTheRunToEndLikeQuiet("strangers");
  EXPECT_THAT(actor_->Err(), Not(HasSubstr("trying again")));
}

// In the middle of the run, with permits and fragments to send.
TEST_F(SecureFleetTest, WorkersGoOnAsSoonAsTheyHaveTheirRightsAgain) {
  const std::string path = folder_ / "access.txt";
  const std::string access = ReadFile(path).value();
  StartSecureLearner("rights");
  const std::string learner_flag = "--learner=" + learner_address_;
  server_ = Start("craftfleet-envserver", "rights-server", Tls("envserver", {"--listen=127.0.0.1:0", learner_flag}));
  actor_ =
      Start("craftfleet-actor", "rights-actor", Tls("actor", {learner_flag, "--envservers=learner", "--threads=2"}));
  WaitForCheckpoint("rights", 2);
  actor_->Signal(SIGSTOP);  // else the run might end before the learner looks at the file
  ASSERT_THAT(ReplaceFile(path, R"(client { name: "others" certificate: "others" right: PLAY })"), IsOk());
  ASSERT_TRUE(learner_->WaitForText("access.txt was read again", kPatience)) << learner_->Err();
  actor_->Signal(SIGCONT);
  for (const Process* worker : {actor_.get(), server_.get()}) {
    ASSERT_TRUE(worker->WaitForText("trying again until it answers", kPatience)) << worker->Err();
  }
  EXPECT_EQ(learner_->Wait(absl::ZeroDuration()), std::nullopt) << "the run ended before its workers were refused";
  ASSERT_THAT(ReplaceFile(path, access), IsOk());
  ExpectTheRunToEndLikeQuiet("rights");
}

// Acts like a port scanner: sends a plausible beginning, then noise. Connections stay open until the end.
class Scanner {
 public:
  ~Scanner() {
    for (const int connection : connections_) close(connection);
  }
  void Scan(const std::string& address) {
    const std::string openings[] = {
        "",
        "GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        std::string("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0", 33),
        std::string("\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", 11),
        "SSH-2.0-OpenSSH_9.2\r\n",
    };
    for (int i = 0; i < 120; ++i) {
      const int connection = ConnectTo(address);
      if (connection < 0) continue;
      connections_.push_back(connection);
      std::string bytes = openings[i % 6];
      // A fifth of the connections send nothing more: half-open.
      for (int j = 0; i % 5 != 0 && j < 2000; ++j) bytes.push_back(static_cast<char>(random_() % 256));
      send(connection, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    }
  }

 private:
  std::mt19937 random_{7};
  std::vector<int> connections_;
};

// Sends a message of 1 GB to `method`, using only one megabyte here.
grpc::Status SendGigabyte(const std::string& address, const wire::ChannelSecurity& security, const char* method) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxSendMessageSize(-1);
  const auto channel = grpc::CreateCustomChannel(address, security.Credentials(), arguments);
  const std::string megabyte(1 << 20, 'x');
  const grpc::Slice slice(megabyte.data(), megabyte.size(), grpc::Slice::STATIC_SLICE);
  const std::vector<grpc::Slice> slices(1024, slice);
  const grpc::ByteBuffer message(slices.data(), slices.size());
  grpc::ClientContext context;
  wire::SetDeadline(&context, kPatience);
  grpc::CompletionQueue queue;
  const auto call = grpc::GenericStub(channel).PrepareUnaryCall(&context, method, message, &queue);
  call->StartCall();
  grpc::ByteBuffer reply;
  grpc::Status status;
  call->Finish(&reply, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  return status;
}

// The peak memory of `process`, MB.
int64_t PeakMemory(const Process& process) {
  const std::string status = ReadFile(absl::StrCat("/proc/", process.pid(), "/status")).value_or("");
  int64_t kilobytes = -1;
  for (const absl::string_view line : absl::StrSplit(status, '\n')) {
    const std::vector<absl::string_view> words = absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
    if (words.size() < 2 || words[0] != "VmHWM:") continue;
    EXPECT_TRUE(absl::SimpleAtoi(words[1], &kilobytes));
  }
  return kilobytes / 1024;
}

TEST_F(SecureFleetTest, GarbageOnEveryPortIsHarmless) {
  StartFleet("garbage");
  const std::string addresses[] = {learner_address_, server_->WaitForAddress("listening on ", kPatience).value(),
                                   actor_->WaitForAddress("status on ", kPatience).value()};
  WaitForCheckpoint("garbage", 2);
  Scanner scanner;
  for (const std::string& address : addresses) scanner.Scan(address);
  EXPECT_EQ(learner_->Wait(absl::ZeroDuration()), std::nullopt) << "the run ended before the scan";
  ExpectTheRunToEndLikeQuiet("garbage");
  EXPECT_THAT(actor_->Err(), Not(HasSubstr("trying again")));
  // A line for each kind of error, not for each connection.
  EXPECT_LT(Lines(learner_->Err()), 60) << learner_->Err();
}

TEST_F(SecureFleetTest, GarbageIsAlsoHarmlessWithoutTls) {
  Fleet fleet = FleetRunTest::StartFleet("plain");
  learner_ = std::move(fleet.learner);
  server_ = std::move(fleet.server);
  actor_ = std::move(fleet.actor);
  const std::string actor_address = actor_->WaitForAddress("status on ", kPatience).value();
  WaitForCheckpoint("plain", 2);
  Scanner scanner;
  for (const std::string& address : {fleet.address, fleet.server_address, actor_address}) scanner.Scan(address);
  for (const Process* process : {learner_.get(), server_.get(), actor_.get()}) {
    const std::string url = process->WaitForAddress("metrics on http://", kPatience).value();
    scanner.Scan(url.substr(0, url.find('/')));
  }
  EXPECT_EQ(learner_->Wait(absl::ZeroDuration()), std::nullopt) << "the run ended before the scan";
  ExpectTheRunToEndLikeQuiet("plain");
  EXPECT_THAT(actor_->Err(), Not(HasSubstr("trying again")));
}

TEST_F(SecureFleetTest, AGigabyteMessageIsRefusedWithoutUsingAGigabyte) {
  StartFleet("gigabyte", {"--max_buffered_mb=256"});
  const std::string server_address = server_->WaitForAddress("listening on ", kPatience).value();
  WaitForCheckpoint("gigabyte", 2);
  const int64_t learner_memory = PeakMemory(*learner_);
  const int64_t server_memory = PeakMemory(*server_);
  const auto security =
      wire::ChannelSecurity::Create({{folder_ / "actor.pem", folder_ / "actor.key", folder_ / "ca.pem"}, ""});
  ASSERT_THAT(security, IsOk());
  // UNAVAILABLE: the connection was reset because it sent so much without a message. That may come first.
  const auto refused = testing::AnyOf(grpc::StatusCode::RESOURCE_EXHAUSTED, grpc::StatusCode::UNAVAILABLE);
  for (const char* method : {"/craftfleet.v1.LearnerService/Join", "/craftfleet.v1.LearnerService/Play"}) {
    EXPECT_THAT(SendGigabyte(learner_address_, *security, method).error_code(), refused);
  }
  EXPECT_THAT(SendGigabyte(server_address, *security, "/craftfleet.v1.EnvironmentService/Play").error_code(), refused);
  const int most = kAddressSanitizer ? 800 : 500;
  EXPECT_LT(PeakMemory(*learner_) - learner_memory, most);
  EXPECT_LT(PeakMemory(*server_) - server_memory, most);
  ExpectTheRunToEndLikeQuiet("gigabyte");
}

}  // namespace
}  // namespace craftfleet
