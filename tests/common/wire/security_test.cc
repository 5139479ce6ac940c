// TLS between a real server and real channels, on loopback.
#include "common/wire/security.h"

#include <fcntl.h>
#include <unistd.h>

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
  ChannelSecurity Client(const std::string& name) const {
    auto security = ChannelSecurity::Create({Files(name), ""});
    EXPECT_THAT(security, IsOk());
    return *std::move(security);
  }
  // `access`: the content of an access file; empty: none.
  std::unique_ptr<Server> Listen(const TlsFiles& files, const std::string& access = "") {
    Server::Options options;
    options.address = "127.0.0.1:0";
    options.files = files;
    if (!access.empty()) {
      options.access_file = folder_ / "access.txt";
      EXPECT_THAT(ReplaceFile(options.access_file, access), IsOk());
    }
    auto server = Server::Create(options, {&status_, &echo_});
    EXPECT_THAT(server, IsOk());
    return *std::move(server);
  }
  static absl::Status GetStatus(const Endpoint& endpoint, const std::string& token = "") {
    grpc::ClientContext context;
    if (!token.empty()) context.AddMetadata("authorization", "Bearer " + token);
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
  const auto server = Listen(Files("stranger"));
  const Endpoint endpoint = Connect(server->address(), Client("client"));
  EXPECT_THAT(GetStatus(endpoint),
              StatusIs(absl::StatusCode::kUnavailable,
                       HasSubstr("its certificate is not from an authority in --tls_ca=" + Pem("ca"))));
  EXPECT_THAT(WaitUntilConnected("server", endpoint, absl::Seconds(10)),
              StatusIs(absl::StatusCode::kUnavailable,
                       AllOf(HasSubstr("server " + server->address() + ": cannot connect: TLS: its certificate"))));
}

TEST_F(SecurityTest, TheServersCertificateMustMatchItsAddress) {
  ca_.Issue("elsewhere", {"elsewhere", 1, /*local=*/false});
  const auto server = Listen(Files("elsewhere"));
  EXPECT_THAT(GetStatus(server->address(), Client("client")),
              StatusIs(absl::StatusCode::kUnavailable,
                       AllOf(HasSubstr("for another name than 127.0.0.1"), HasSubstr("--tls_server_name"))));
  EXPECT_THAT(GetStatus(server->address(), Client("client").ForServer("elsewhere")), IsOk());
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
  const auto tls = Listen(Files("server"));
  const auto plain = Listen({});
  ErrorLog([&] {
    EXPECT_THAT(GetStatus(tls->address(), {}), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("give --tls_ca")));
  });
  EXPECT_THAT(GetStatus(plain->address(), Client("client")),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("does not speak TLS")));
}

TEST_F(SecurityTest, CertificatesGiveRights) {
  ca_.Issue("worker", {"worker"});
  const auto server = Listen(Files("server"), R"(
      client { name: "monitor" certificate: "client" right: WATCH }
      client { name: "workers" certificate: "work*" right: PLAY })");
  EXPECT_THAT(GetStatus(server->address(), Client("client")), IsOk());
  EXPECT_THAT(Play(server->address(), Client("worker")), IsOk());

  const std::string log = ErrorLog(
      [&] {
        EXPECT_THAT(Play(server->address(), Client("client")),
                    StatusIs(absl::StatusCode::kPermissionDenied,
                             AllOf(HasSubstr("not allowed"), HasSubstr("gives this process' certificate no right"),
                                   Not(HasSubstr("monitor\"")))));
        EXPECT_THAT(GetStatus(server->address(), Client("server")),
                    StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("not allowed")));
      },
      "no client with this certificate");
  EXPECT_THAT(log, AllOf(HasSubstr("refused /craftfleet.v1.EnvironmentService/Play: wire_test@"),
                         HasSubstr("it is \"monitor\" in the access file, without the right to play"),
                         HasSubstr("the access file has no client with this certificate")));
}

TEST_F(SecurityTest, ATokenAdmitsNoProcess) {
  constexpr char kReader[] = R"(client { name: "reader" token_sha256: "%s" right: WATCH })";
  const auto server = Listen(Files("server"), absl::StrFormat(kReader, Sha256Hex("reader's")));
  const std::string log = ErrorLog(
      [&] {
        EXPECT_THAT(GetStatus(Connect(server->address(), Client("client")), "reader's"),
                    StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("not allowed")));
      },
      "no client with this certificate");
  EXPECT_THAT(log, Not(HasSubstr("reader's")));
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
  auto ops = ChannelSecurity::Create({files("ops"), ""});
  ASSERT_THAT(ops, IsOk());
  EXPECT_THAT(GetStatus(server->address(), *ops), IsOk());
  EXPECT_THAT(GetStatus(server->address(), ops->ForServer("learner.example.com")), IsOk());
  // Again: the same authority, new certificates.
  const std::string before = *ReadFile(made + "/ops.pem");
  const std::string authority = *ReadFile(made + "/ca.pem");
  ASSERT_EQ(std::system((script + "ops").c_str()), 0);
  EXPECT_EQ(*ReadFile(made + "/ca.pem"), authority);
  EXPECT_NE(*ReadFile(made + "/ops.pem"), before);
  EXPECT_THAT(GetStatus(server->address(), *ChannelSecurity::Create({files("ops"), ""})), IsOk());
}

TEST_F(SecurityTest, ConflictingOptionsAreNamed) {
  EXPECT_THAT(ChannelSecurity::Create({{}, "name"}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_server_name requires --tls_ca")));
  EXPECT_THAT(ChannelSecurity::Create({{Pem("client"), "", ""}, ""}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_cert requires --tls_key")));
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

// Without one, TLS gave every stranger all rights.
TEST_F(SecurityTest, WithTlsAServerNeedsTheAuthorityOfItsClients) {
  Server::Options options;
  options.files = Files("server", "");
  options.insecure = true;
  options.access_file = "access.txt";
  for (const char* address : {"0.0.0.0:0", "127.0.0.1:0", "unix:socket"}) {
    options.address = address;
    EXPECT_THAT(options.Validate(),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_cert requires --tls_ca")));
  }
  options.address = "";  // of a run in one process, whose page has the certificate
  options.access_file = "";
  EXPECT_THAT(Server::Create(options, {&status_}), IsOk());
}

}  // namespace
}  // namespace craftfleet::wire
