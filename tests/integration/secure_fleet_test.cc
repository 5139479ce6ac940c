// A fleet under attack: wrong credentials, garbage and new certificates do not change the run's result.

#include <sys/socket.h>
#include <unistd.h>

#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <grpcpp/completion_queue.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/generic/generic_stub.h>
#include <gtest/gtest.h>

#include "common/wire/certificates.h"
#include "common/wire/channel.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "tests/fakes/loopback.h"
#include "tests/fakes/sanitizers.h"
#include "tests/fakes/test_certificates.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/secure_fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class SecureFleetTest : public SecureFleetFixture {
 protected:
  SecureFleetTest()
      : SecureFleetFixture({"learner", "envserver", "actor", "actor-2", "monitor", "guest"},
                           absl::StrFormat(R"(
                  client { name: "workers" certificate: "actor*" right: PLAY }
                  client { name: "servers" certificate: "envserver" right: SERVE }
                  client { name: "monitor" certificate: "monitor" right: WATCH }
                  client { name: "guest with token" certificate: "guest" token_sha256: "%s" right: WATCH })",
                                           wire::Sha256Hex("sesame"))) {}

  wire::TlsFiles FilesOf(const std::string& name) const {
    return {folder_ / (name + ".pem"), folder_ / (name + ".key"), folder_ / "ca.pem"};
  }

  // `more`: flags of the learner and the environment server.
  void StartFleet(const std::string& run, const std::vector<std::string>& more = {}) {
    StartSecureLearner(run, more);
    StartWorkers(run, more);
  }

  // Runs `program`, expects it to fail, and returns its standard error.
  std::string Fail(const std::string& program, std::vector<std::string> flags) {
    const auto process = Start(program, absl::StrCat("intruder-", ++intruders_), flags);
    EXPECT_EQ(process->Wait(kPatience), 1);
    return process->Err();
  }
  std::string FailToAsk(std::vector<std::string> flags) {
    flags.push_back("--address=" + learner_address_);
    return Fail("craftfleet status", std::move(flags));
  }

  int intruders_ = 0;
};

TEST_F(SecureFleetTest, StrangersAreRefusedAndTheRunIsTheSame) {
  TestAuthority other(folder_, "other");
  other.Issue("stranger", {"actor"});
  ca_.Issue("old", {"actor", 1, true, -7200, -3600});
  ASSERT_THAT(WriteFileSynced(folder_ / "wrong", "open\n"), IsOk());
  ASSERT_THAT(WriteFileSynced(folder_ / "right", "sesame\n"), IsOk());
  StartFleet("strangers");
  WaitForCheckpoint("strangers", 2);

  EXPECT_THAT(FailToAsk({}), HasSubstr("if it speaks TLS, give --tls_ca"));
  EXPECT_THAT(FailToAsk({"--tls_ca=" + (folder_ / "ca.pem")}), HasSubstr("give --tls_cert and --tls_key"));
  EXPECT_THAT(FailToAsk({"--tls_ca=" + (folder_ / "other.pem")}), HasSubstr("not from an authority in --tls_ca"));
  EXPECT_THAT(FailToAsk(Tls("stranger")), HasSubstr("not from an authority in --tls_ca"));
  EXPECT_THAT(FailToAsk(Tls("old")), HasSubstr("expired on 20"));
  EXPECT_THAT(FailToAsk(Tls("guest")), HasSubstr("not allowed"));
  EXPECT_THAT(FailToAsk(Tls("guest", {"--token_file=" + (folder_ / "wrong")})),
              HasSubstr("check the token in --token_file"));
  EXPECT_THAT(FailToAsk(Tls("actor")), HasSubstr("no right to this"));
  EXPECT_THAT(Fail("craftfleet-actor", Tls("monitor", {"--learner=" + learner_address_, "--envservers=learner"})),
              AllOf(HasSubstr("learner " + learner_address_ + ": not allowed"), HasSubstr("no right to this")));
  for (const char* verb : {"pause", "stop"}) {
    EXPECT_THAT(Fail("craftfleet admin", Tls("monitor", {"--address=" + learner_address_, verb})),
                AllOf(HasSubstr("not allowed"), HasSubstr("no right to this")));
  }
  for (const auto& flags : {Tls("monitor"), Tls("guest", {"--token_file=" + (folder_ / "right")})}) {
    std::vector<std::string> ask = flags;
    ask.push_back("--address=" + learner_address_);
    EXPECT_EQ(Start("craftfleet status", "watcher", ask)->Wait(kPatience), 0);
  }

  EXPECT_THAT(learner_->Err(), AllOf(HasSubstr("gRPC: Handshake failed"),
                                     HasSubstr("refused /craftfleet.v1.StatusService/GetStatus: craftfleet@"),
                                     HasSubstr("the access file has no client with this certificate and no token"),
                                     HasSubstr("its token is not in the access file"),
                                     HasSubstr("it is \"monitor\" in the access file, without the right to play"),
                                     HasSubstr("it is \"monitor\" in the access file, without the right to steer"),
                                     HasSubstr("it is \"workers\" in the access file, without the right to watch")));
  EXPECT_THAT(learner_->Err(), Not(HasSubstr("sesame")));
  ExpectTheRunToEndLikeQuiet("strangers");
  EXPECT_THAT(actor_->Err(), Not(HasSubstr("trying again")));
}

// Calls a unary method of the learner at `address` with the given TLS files.
template <typename Reply, typename Request>
absl::Status CallLearner(const std::string& address, const wire::TlsFiles& files,
                         grpc::Status (v1::LearnerService::Stub::*method)(grpc::ClientContext*, const Request&, Reply*),
                         const Request& request) {
  const auto security = wire::ChannelSecurity::Create({files, "", ""});
  if (!security.ok()) return security.status();
  const auto stub = v1::LearnerService::NewStub(wire::Connect(address, *security).channel);
  grpc::ClientContext context;
  wire::SetDeadline(&context, kPatience);
  Reply reply;
  return wire::FromGrpc((stub.get()->*method)(&context, request, &reply), "learner");
}

TEST_F(SecureFleetTest, NoWorkerCanActUnderAnothersName) {
  StartFleet("names");
  const std::string server_address = server_->WaitForAddress("listening on ", kPatience).value();
  WaitForCheckpoint("names", 2);
  // Names are no secret: the learner's status page shows them.
  const auto monitor = wire::ChannelSecurity::Create({FilesOf("monitor"), "", ""});
  ASSERT_THAT(monitor, IsOk());
  grpc::ClientContext context;
  v1::StatusReply status;
  ASSERT_TRUE(v1::StatusService::NewStub(wire::Connect(learner_address_, *monitor).channel)
                  ->GetStatus(&context, {}, &status)
                  .ok());
  int tried = 0;
  for (const v1::Peer& peer : status.peers()) {
    if (peer.role() == "actor") {
      v1::LeaveRequest leave;
      leave.set_actor(peer.name());
      EXPECT_THAT(CallLearner(learner_address_, FilesOf("actor-2"), &v1::LearnerService::Stub::Leave, leave),
                  StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr(peer.name())));
      // Environment servers have no right to permits at all.
      EXPECT_THAT(CallLearner(learner_address_, FilesOf("envserver"), &v1::LearnerService::Stub::Leave, leave),
                  StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("not allowed")));
      ++tried;
    } else if (peer.role() == "envserver") {
      v1::Announcement announcement;
      announcement.set_protocol_version(wire::kProtocolVersion);
      announcement.set_name(peer.name());
      announcement.set_address(server_address);
      announcement.set_leaving(true);
      EXPECT_THAT(CallLearner(learner_address_, FilesOf("actor"), &v1::LearnerService::Stub::Announce, announcement),
                  StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("not allowed")));
      ++tried;
    }
  }
  EXPECT_EQ(tried, 2);
  EXPECT_EQ(learner_->Wait(absl::ZeroDuration()), std::nullopt) << "the run ended before the attempts";
  EXPECT_THAT(learner_->Err(), HasSubstr("refused certificate 127.0.0.1, actor-2, localhost: actor"));
  ExpectTheRunToEndLikeQuiet("names");
  EXPECT_THAT(actor_->Err(), Not(HasSubstr("lapsed")));
}

// In the middle of the run, with permits and fragments to send.
TEST_F(SecureFleetTest, TokensReplacedWithoutOverlapAreUsed) {
  const auto allow = [&](const std::string& token) {
    ASSERT_THAT(ReplaceFile(folder_ / "access.txt", absl::StrFormat(R"(
                  client { name: "workers" certificate: "actor" token_sha256: "%1$s" right: PLAY }
                  client { name: "servers" certificate: "envserver" token_sha256: "%1$s" right: SERVE })",
                                                                    wire::Sha256Hex(token))),
                IsOk());
  };
  allow("old");
  ASSERT_THAT(WriteFileSynced(folder_ / "token", "old\n"), IsOk());
  const std::string token_flag = "--token_file=" + (folder_ / "token");
  StartSecureLearner("token");
  const std::string learner_flag = "--learner=" + learner_address_;
  server_ = Start("craftfleet-envserver", "token-server",
                  Tls("envserver", {"--listen=127.0.0.1:0", learner_flag, token_flag}));
  actor_ = Start("craftfleet-actor", "token-actor",
                 Tls("actor", {learner_flag, "--envservers=learner", "--threads=2", token_flag}));
  WaitForCheckpoint("token", 2);
  allow("new");
  for (const Process* worker : {actor_.get(), server_.get()}) {
    ASSERT_TRUE(worker->WaitForText("trying again until it answers", kPatience)) << worker->Err();
  }
  EXPECT_EQ(learner_->Wait(absl::ZeroDuration()), std::nullopt) << "the run ended before its workers were refused";
  ASSERT_THAT(ReplaceFile(folder_ / "token", "new\n"), IsOk());
  ExpectTheRunToEndLikeQuiet("token");
  for (const Process* worker : {actor_.get(), server_.get()}) EXPECT_THAT(worker->Err(), HasSubstr("was read again"));
}

// Returns the serial number of a process's certificate, in hexadecimal.
std::string SerialAt(const std::string& address, const std::vector<std::string>& flags, const std::string& file) {
  const std::string command = absl::StrFormat(
      "openssl s_client -connect %s -cert %s -key %s -CAfile %s -alpn h2 </dev/null 2>/dev/null | "
      "openssl x509 -noout -serial > %s",
      address, flags[0].substr(flags[0].find('=') + 1), flags[1].substr(flags[1].find('=') + 1),
      flags[2].substr(flags[2].find('=') + 1), file);
  return std::system(command.c_str()) == 0 ? ReadFile(file).value_or("") : "";
}

TEST_F(SecureFleetTest, NewCertificatesAreUsedAndNoConnectionIsLost) {
  StartFleet("renewed");
  const std::string server_address = server_->WaitForAddress("listening on ", kPatience).value();
  WaitForCheckpoint("renewed", 2);
  for (const char* name : {"learner", "envserver", "actor", "monitor"}) ca_.Issue(name, {name, 4096});
  for (const std::string& address : {learner_address_, server_address}) {
    EXPECT_TRUE(WaitUntil([&] { return SerialAt(address, Tls("monitor"), folder_ / "shown") == "serial=1000\n"; }))
        << address;
  }
  EXPECT_EQ(learner_->Wait(absl::ZeroDuration()), std::nullopt) << "the run ended before the renewal";
  // Another actor, which only ever gets the new certificates.
  const auto late = Start("craftfleet-actor", "renewed-late",
                          Tls("actor", {"--learner=" + learner_address_, "--envservers=learner", "--threads=1"}));
  ASSERT_TRUE(late->WaitForText("joined run", kPatience)) << late->Err();
  EXPECT_THAT(server_->Err(), Not(HasSubstr("trying again")));
  ExpectTheRunToEndLikeQuiet("renewed");
  EXPECT_EQ(late->Wait(absl::Seconds(10)), 0) << late->Err();
  for (const Process* process : {actor_.get(), late.get()}) {
    EXPECT_THAT(process->Err(), AllOf(Not(HasSubstr("trying again")), Not(HasSubstr("closed"))));
  }
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
  const auto security = wire::ChannelSecurity::Create({FilesOf("actor"), "", ""});
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
