// TLS and tokens between a real server and real channels, on loopback.
#include "common/wire/security.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "common/wire/certificates.h"
#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "tests/fakes/echo_service.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"
#include "tests/fakes/test_paths.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class SecurityTest : public testing::Test {
 protected:
  SecurityTest() {
    ca_.Issue("server", {"server", 100});
    ca_.Issue("client", {"client", 200});
  }

  std::string Pem(const std::string& name) const { return folder_ / (name + ".pem"); }
  TlsFiles Files(const std::string& name, const std::string& ca = "ca") const {
    TlsFiles files;
    if (!name.empty()) files = {Pem(name), folder_ / (name + ".key"), ""};
    if (!ca.empty()) files.authorities = Pem(ca);
    return files;
  }
  // A client with the certificate `name`, or none if it is empty.
  ChannelSecurity Client(const std::string& name, const std::string& ca = "ca", const std::string& token = "") const {
    auto security = ChannelSecurity::Create({Files(name, ca), "", token});
    EXPECT_THAT(security, IsOk());
    return *std::move(security);
  }
  std::unique_ptr<Server> Listen(const TlsFiles& files, const std::string& access_file = "", bool ask = true) {
    Server::Options options;
    options.address = "127.0.0.1:0";
    options.files = files;
    options.ask_clients = ask;
    options.access_file = access_file;
    auto server = Server::Create(options, {&status_, &echo_});
    EXPECT_THAT(server, IsOk());
    return *std::move(server);
  }
  // Clients with `token` may watch.
  std::unique_ptr<Server> ListenWithToken(const std::string& token) {
    const std::string access = folder_ / "access.txt";
    constexpr char kClient[] = R"(client { name: "a" token_sha256: "%s" right: WATCH })";
    EXPECT_THAT(ReplaceFile(access, absl::StrFormat(kClient, Sha256Hex(token))), IsOk());
    return Listen(Files("server", ""), access);
  }
  std::string WriteToken(const std::string& name, const std::string& token) const {
    EXPECT_THAT(ReplaceFile(folder_ / name, token + "\n"), IsOk());
    return folder_ / name;
  }
  static absl::Status GetStatus(const Endpoint& endpoint) {
    grpc::ClientContext context;
    SetDeadline(&context, absl::Seconds(20));
    v1::StatusReply reply;
    return FromCall(v1::StatusService::NewStub(endpoint.channel)->GetStatus(&context, {}, &reply), "server", endpoint);
  }
  static absl::Status GetStatus(const std::string& address, const ChannelSecurity& security) {
    return GetStatus(Connect(address, security));
  }
  // One message there and back on a stream.
  static absl::Status Play(const std::string& address, const ChannelSecurity& security) {
    const Endpoint endpoint = Connect(address, security);
    grpc::ClientContext context;
    SetDeadline(&context, absl::Seconds(20));
    const auto stream = v1::EnvironmentService::NewStub(endpoint.channel)->Play(&context);
    v1::PlayReply reply;
    if (stream->Write({}) && stream->Read(&reply)) return absl::OkStatus();
    return FromCall(stream->Finish(), "server", endpoint);
  }
  // The log lines written during `action`. Waits until they contain `awaited`, since a server may log a refusal after
  // the client has received it.
  std::string ErrorLog(const std::function<void()>& action, const std::string& awaited = "") const {
    const std::string path = folder_ / "stderr";
    const int log = open(path.c_str(), O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0600);
    const int before = dup(STDERR_FILENO);
    dup2(log, STDERR_FILENO);
    action();
    WaitUntil([&] { return absl::StrContains(ReadFile(path).value_or(""), awaited); });
    dup2(before, STDERR_FILENO);
    close(before);
    close(log);
    return ReadFile(path).value_or("");
  }

  const TempFolder folder_;
  TestAuthority ca_{folder_, "ca"};
  StatusServiceImpl status_{"actor", [](v1::StatusReply* /*reply*/) {}};
  EchoService echo_;
};

TEST_F(SecurityTest, AcceptsCertificatesOnBothSides) {
  const auto server = Listen(Files("server"));
  EXPECT_THAT(GetStatus(server->address(), Client("client")), IsOk());
  EXPECT_THAT(Play(server->address(), Client("client")), IsOk());
  EXPECT_THAT(WaitUntilConnected("server", Connect(server->address(), Client("client")), absl::Seconds(10)), IsOk());
}

TEST_F(SecurityTest, ClientsNeedNoCertificateIfTheServerRequiresNone) {
  EXPECT_THAT(GetStatus(Listen(Files("server", ""))->address(), Client("")), IsOk());
  EXPECT_THAT(GetStatus(Listen(Files("server"), "", /*ask=*/false)->address(), Client("")), IsOk());
}

TEST_F(SecurityTest, AClientWithoutCertificateIsRefused) {
  const auto server = Listen(Files("server"));
  const std::string log = ErrorLog(
      [&] {
        EXPECT_THAT(GetStatus(server->address(), Client("")),
                    StatusIs(absl::StatusCode::kUnavailable,
                             AllOf(HasSubstr("server: TLS: "), HasSubstr("give --tls_cert and --tls_key"))));
      },
      "gRPC: Handshake failed");
  EXPECT_THAT(log, HasSubstr("peer did not return a certificate"));
}

TEST_F(SecurityTest, ACertificateOfAnotherAuthorityIsRefused) {
  TestAuthority other(folder_, "other");
  other.Issue("stranger", {"client"});
  const auto server = Listen(Files("server"));
  const std::string log = ErrorLog(
      [&] {
        EXPECT_THAT(GetStatus(server->address(), Client("stranger")),
                    StatusIs(absl::StatusCode::kUnavailable,
                             AllOf(HasSubstr("it may have refused --tls_cert=" + Pem("stranger")),
                                   HasSubstr("not from an authority in --tls_ca=" + Pem("ca")))));
      },
      "gRPC: Handshake failed");
  EXPECT_THAT(log, HasSubstr("certificate verify failed"));
}

TEST_F(SecurityTest, AnExpiredCertificateIsRefused) {
  ca_.Issue("old", {"client", 1, true, -7200, -3600});
  const auto server = Listen(Files("server"));
  ErrorLog([&] {
    EXPECT_THAT(GetStatus(server->address(), Client("old")),
                StatusIs(absl::StatusCode::kUnavailable,
                         AllOf(HasSubstr("--tls_cert=" + Pem("old")), HasSubstr("expired on 20"))));
  });
}

TEST_F(SecurityTest, AnExpiredCertificateIsWarnedOfOnce) {
  ca_.Issue("old", {"client", 1, true, -7200, -3600});
  testing::internal::CaptureStderr();
  for (int i = 0; i < 2; ++i) EXPECT_THAT(Files("old").Validate(), IsOk());
  const std::string log = testing::internal::GetCapturedStderr();
  const std::vector<std::string> parts = absl::StrSplit(log, "expired on");
  EXPECT_EQ(parts.size(), 2U) << log;
}

TEST_F(SecurityTest, AServerOfAnotherAuthorityIsNotTrusted) {
  TestAuthority other(folder_, "other");
  other.Issue("stranger", {"stranger"});
  const auto server = Listen(Files("stranger", ""));
  const Endpoint endpoint = Connect(server->address(), Client(""));
  EXPECT_THAT(GetStatus(endpoint),
              StatusIs(absl::StatusCode::kUnavailable,
                       HasSubstr("its certificate is not from an authority in --tls_ca=" + Pem("ca"))));
  EXPECT_THAT(WaitUntilConnected("server", endpoint, absl::Seconds(10)),
              StatusIs(absl::StatusCode::kUnavailable,
                       AllOf(HasSubstr("server " + server->address() + ": cannot connect: TLS: its certificate"))));
}

TEST_F(SecurityTest, TheServersCertificateMustMatchItsAddress) {
  ca_.Issue("elsewhere", {"elsewhere", 1, /*local=*/false});
  const auto server = Listen(Files("elsewhere", ""));
  EXPECT_THAT(GetStatus(server->address(), Client("")),
              StatusIs(absl::StatusCode::kUnavailable,
                       AllOf(HasSubstr("for another name than 127.0.0.1"), HasSubstr("--tls_server_name"))));
  EXPECT_THAT(GetStatus(server->address(), Client("").ForServer("elsewhere")), IsOk());
}

// Each process that was killed left this advice in the logs of its peers.
TEST_F(SecurityTest, ALostConnectionIsNotTakenForTls) {
  const auto explain = [](absl::string_view error) {
    return std::string(ChannelSecurity().Explain(absl::UnavailableError(error), "127.0.0.1:1").message());
  };
  EXPECT_EQ(explain("Socket closed"), "Socket closed");
  EXPECT_THAT(explain("failed to connect to all addresses; last error: UNAVAILABLE: ipv4:127.0.0.1:1: Socket closed"),
              HasSubstr("give --tls_ca"));
}

TEST_F(SecurityTest, MixingTlsAndPlaintextExplainsWhatToChange) {
  const auto tls = Listen(Files("server", ""));
  const auto plain = Listen({});
  ErrorLog([&] {
    EXPECT_THAT(GetStatus(tls->address(), {}), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("give --tls_ca")));
  });
  EXPECT_THAT(GetStatus(plain->address(), Client("")),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("does not speak TLS")));
}

TEST_F(SecurityTest, TokensGiveRights) {
  const std::string access = folder_ / "access.txt";
  ASSERT_THAT(ReplaceFile(access, absl::StrFormat(R"(
                client { name: "monitor" token_sha256: "%s" right: WATCH }
                client { name: "worker" token_sha256: "%s" right: PLAY })",
                                                  Sha256Hex("monitor's"), Sha256Hex("worker's"))),
              IsOk());
  const auto server = Listen(Files("server", ""), access);
  const std::string monitor = WriteToken("monitor", "monitor's");
  const std::string worker = WriteToken("worker", "worker's");
  const std::string wrong = WriteToken("wrong", "wrong");
  EXPECT_THAT(GetStatus(server->address(), Client("", "ca", monitor)), IsOk());
  EXPECT_THAT(Play(server->address(), Client("", "ca", worker)), IsOk());

  const std::string log = ErrorLog(
      [&] {
        EXPECT_THAT(Play(server->address(), Client("", "ca", monitor)),
                    StatusIs(absl::StatusCode::kPermissionDenied,
                             AllOf(HasSubstr("not allowed"), Not(HasSubstr("monitor\"")))));
        EXPECT_THAT(
            GetStatus(server->address(), Client("", "ca", wrong)),
            StatusIs(absl::StatusCode::kUnauthenticated, HasSubstr("check the token in --token_file=" + wrong)));
        EXPECT_THAT(GetStatus(server->address(), Client("")),
                    StatusIs(absl::StatusCode::kUnauthenticated, HasSubstr("give --token_file")));
      },
      "it sent no token");
  EXPECT_THAT(log, AllOf(HasSubstr("refused /craftfleet.v1.EnvironmentService/Play: wire_test@"),
                         HasSubstr("it is \"monitor\" in the access file, without the right to play"),
                         HasSubstr("its token is not in the access file"), HasSubstr("it sent no token"),
                         Not(HasSubstr("monitor's"))));
}

TEST_F(SecurityTest, AChangedTokenIsUsed) {
  const auto server = ListenWithToken("new");
  const Endpoint endpoint = Connect(server->address(), Client("", "ca", WriteToken("token", "old")));
  ErrorLog([&] { EXPECT_FALSE(GetStatus(endpoint).ok()); });
  WriteToken("token", "new");
  ErrorLog([&] { EXPECT_TRUE(WaitUntil([&] { return GetStatus(endpoint).ok(); })); });
}

TEST_F(SecurityTest, WhatIsNoTokenLeavesTheFormerOneInUse) {
  const auto server = ListenWithToken("old");
  const std::string path = WriteToken("token", "old");
  const ChannelSecurity client = Client("", "ca", path);
  ErrorLog(
      [&] {
        WriteToken("token", "\xff\x01 binary");
        absl::SleepFor(absl::Seconds(1.5));  // longer than the interval between checks
        EXPECT_THAT(GetStatus(server->address(), client), IsOk());
      },
      "the former token remains in use");
  for (const std::string& text : {std::string(), std::string("two\nlines"), std::string(5000, 'x')}) {
    WriteToken("token", text);
    EXPECT_THAT(ChannelSecurity::Create({Files("", "ca"), "", path}),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want one line")));
  }
}

TEST_F(SecurityTest, NoCallWaitsForTheTokenFile) {
  const auto server = ListenWithToken("old");
  const std::string path = WriteToken("token", "old");
  const Endpoint endpoint = Connect(server->address(), Client("", "ca", path));
  // Simulates a hanging disk: opening a FIFO blocks until it has a writer.
  ASSERT_EQ(std::remove(path.c_str()), 0);
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  absl::SleepFor(absl::Seconds(1.5));  // longer than the interval between checks
  EXPECT_THAT(GetStatus(endpoint), IsOk());
}

TEST_F(SecurityTest, HandlersCanIdentifyTheCaller) {
  const auto server = Listen(Files("server"));
  EXPECT_THAT(Play(server->address(), Client("client")), IsOk());
  EXPECT_EQ(echo_.identity(), "certificate 127.0.0.1, client, localhost");
}

// The serial number of the certificate that the server presents on a new connection.
std::string SerialOf(const std::string& address, const std::string& ca, const std::string& folder) {
  const std::string file = folder + "/shown";
  const std::string command = absl::StrFormat(
      "openssl s_client -connect %s -CAfile %s -alpn h2 </dev/null 2>/dev/null | openssl x509 -noout -serial > %s",
      address, ca, file);
  if (std::system(command.c_str()) != 0) return "none";
  return ReadFile(file).value_or("none");
}

TEST_F(SecurityTest, ReplacedCertificatesAreUsedAndNoConnectionIsLost) {
  const auto server = Listen(Files("server"));
  const Endpoint endpoint = Connect(server->address(), Client("client"));
  grpc::ClientContext context;
  const auto stream = v1::EnvironmentService::NewStub(endpoint.channel)->Play(&context);
  v1::PlayReply reply;
  ASSERT_TRUE(stream->Write({}) && stream->Read(&reply));
  EXPECT_EQ(SerialOf(server->address(), Pem("ca"), folder_.path()), "serial=64\n");

  // Both sides get new certificates, of a new authority.
  TestAuthority next(folder_, "ca");
  next.Issue("server", {"server", 101});
  next.Issue("client", {"client", 201});
  ErrorLog([&] {
    EXPECT_TRUE(WaitUntil([&] { return SerialOf(server->address(), Pem("ca"), folder_.path()) == "serial=65\n"; }));
    EXPECT_TRUE(WaitUntil([&] { return GetStatus(server->address(), Client("client")).ok(); }));
  });
  EXPECT_TRUE(stream->Write({}) && stream->Read(&reply));
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());
}

// gRPC's own watcher aborts the process when it finds an empty file, and refuses clients while a file is not valid.
TEST_F(SecurityTest, SpoiltFilesLeaveTheFormerCertificatesInUse) {
  const auto server = Listen(Files("server"));
  const ChannelSecurity client = Client("client");
  const std::string log = ErrorLog([&] {
    for (const std::string& text : {std::string(), std::string("no certificate")}) {
      for (const char* file : {"server.pem", "server.key", "client.pem", "client.key", "ca.pem"}) {
        ASSERT_THAT(WriteFileSynced(folder_ / file, text), IsOk());
      }
      absl::SleepFor(absl::Seconds(2.5));  // two looks at the files
      EXPECT_THAT(GetStatus(server->address(), client), IsOk());
    }
  });
  EXPECT_THAT(log, HasSubstr("--tls_cert=" + Pem("server") + ": no certificate in it"));
  EXPECT_THAT(log, HasSubstr("the former certificates remain in use"));
}

TEST_F(SecurityTest, MakeCertsCreatesWorkingCertificates) {
  const std::string made = folder_ / "made";
  const std::string script = SourcePath("deploy/make-certs.sh") + " " + made + " > /dev/null ";
  ASSERT_EQ(std::system((script + "learner=learner.example.com,10.0.0.5 ops").c_str()), 0);
  const auto files = [&](const std::string& name) {
    return TlsFiles{made + "/" + name + ".pem", made + "/" + name + ".key", made + "/ca.pem"};
  };
  const auto server = Listen(files("learner"));
  auto ops = ChannelSecurity::Create({files("ops"), "", ""});
  ASSERT_THAT(ops, IsOk());
  EXPECT_THAT(GetStatus(server->address(), *ops), IsOk());
  EXPECT_THAT(GetStatus(server->address(), ops->ForServer("learner.example.com")), IsOk());
  // Again: the same authority, new certificates.
  const std::string before = *ReadFile(made + "/ops.pem");
  const std::string authority = *ReadFile(made + "/ca.pem");
  ASSERT_EQ(std::system((script + "ops").c_str()), 0);
  EXPECT_EQ(*ReadFile(made + "/ca.pem"), authority);
  EXPECT_NE(*ReadFile(made + "/ops.pem"), before);
  EXPECT_THAT(GetStatus(server->address(), *ChannelSecurity::Create({files("ops"), "", ""})), IsOk());
}

TEST_F(SecurityTest, ConflictingOptionsAreNamed) {
  EXPECT_THAT(ChannelSecurity::Create({{}, "", "token"}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--token_file requires --tls_ca")));
  EXPECT_THAT(ChannelSecurity::Create({{}, "name", ""}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_server_name requires --tls_ca")));
  EXPECT_THAT(ChannelSecurity::Create({{Pem("client"), "", ""}, "", ""}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_cert requires --tls_key")));
  EXPECT_THAT(ChannelSecurity::Create({Files("", "ca"), "", folder_ / "no token"}),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("--token_file: cannot open " + folder_ / "no token")));
  EXPECT_THAT(ChannelSecurity::Create({Files("", "ca"), "", Pem("ca")}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--token_file=" + Pem("ca") + " is not a token")));
  Server::Options options;
  options.access_file = "access.txt";
  EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--access_file requires")));
}

TEST_F(SecurityTest, WithTlsAServerThatKnowsItsClientsMayListenBeyondThisHost) {
  Server::Options options;
  options.address = "0.0.0.0:0";
  EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_cert")));
  options.files = Files("server", "ca");
  EXPECT_THAT(options.Validate(), IsOk());
}

// TLS without a CA gave every stranger all rights.
TEST_F(SecurityTest, WithTlsAServerThatAdmitsStrangersMayNot) {
  Server::Options options;
  options.address = "0.0.0.0:0";
  options.files = Files("server", "");
  EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument,
                                           testing::AllOf(HasSubstr("--listen=0.0.0.0:0"), HasSubstr("--tls_ca"))));
  options.insecure = true;
  EXPECT_THAT(options.Validate(), IsOk());
  options.insecure = false;
  options.access_file = "access.txt";
  EXPECT_THAT(options.Validate(), IsOk()) << "it has rights only for those whom it knows";
  options.access_file.clear();
  options.files = Files("server", "ca");
  options.ask_clients = false;
  EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_client_certs")));
}

}  // namespace
}  // namespace craftfleet::wire
