#include "common/wire/channel.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <memory>
#include <string>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>

#include "common/wire/http_server.h"
#include "common/wire/server.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

TEST(Address, AcceptsHostAndPortOrUnixSocket) {
  for (const char* address :
       {"127.0.0.1:50051", "learner:1", "[::1]:65535", "learner.fleet.svc:0", "unix:/tmp/x", "unix:x"}) {
    EXPECT_THAT(CheckAddress("listen", address), IsOk()) << address;
  }
}

TEST(Address, RefusesOtherTextWithFlagAndValue) {
  for (const char* address : {"", "localhost", ":50051", "localhost:", "localhost:http", "localhost:-1",
                              "localhost:65536", "localhost:5 0", "unix:", "50051"}) {
    EXPECT_THAT(CheckAddress("learner", address),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr("--learner: \"" + std::string(address) + "\""), HasSubstr("HOST:PORT"))))
        << address;
  }
}

TEST(Address, SaysWhatToWriteInstead) {
  const auto refused = [](const std::string& address, const std::string& want) {
    EXPECT_THAT(CheckAddress("learner", address), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(want)))
        << address;
  };
  refused("http://learner:1", "without http://");
  refused("dns:///learner:1", "without dns://");
  refused("::1:50051", "in brackets, such as [::1]:50051");
  refused("learner:1/", "HOST:PORT");
  refused("127.0.0.1:50051/", "HOST:PORT");
  refused("a b:1", "HOST:PORT");
  refused("127.0.0.1:99999", "HOST:PORT");
  refused("learner:+1", "HOST:PORT");
  refused("unix:/a,b", "without commas");
  refused("unix:" + std::string(108, 'a'), "at most 107 bytes");
  EXPECT_THAT(CheckAddress("learner", "unix:" + std::string(107, 'a')), IsOk());
}

TEST(Address, ClientsOfGrpcGetTheUriOfAUnixSocket) {
  EXPECT_EQ(GrpcAddress("unix:/tmp/gr\u00f6\u00dfe 5%25/a-b_c.~"), "unix:/tmp/gr%C3%B6%C3%9Fe%205%2525/a-b_c.~");
  EXPECT_EQ(GrpcAddress("[::1]:5"), "[::1]:5");
}

TEST(WaitUntilConnected, ReachesAServerOnLoopback) {
  v1::StatusService::Service service;
  const auto server = Server::Create({"127.0.0.1:0"}, {&service});
  ASSERT_THAT(server, IsOk());
  EXPECT_THAT(WaitUntilConnected("learner", Connect((*server)->address()), absl::Seconds(10)), IsOk());
}

TEST(WaitUntilConnected, NamesAPeerThatCannotBeReached) {
  std::string address;
  {
    v1::StatusService::Service service;
    const auto server = Server::Create({"127.0.0.1:0"}, {&service});
    ASSERT_THAT(server, IsOk());
    address = (*server)->address();
  }
  EXPECT_THAT(WaitUntilConnected("learner", Connect(address), absl::Seconds(10)),
              StatusIs(absl::StatusCode::kUnavailable,
                       HasSubstr("learner " + address + ": cannot connect: nothing listens there")));
}

TEST(WaitUntilConnected, RecognizesAServerOfPages) {
  const auto server = HttpServer::Create({"127.0.0.1:0"},
                                         [](const HttpServer::Request& /*request*/) { return HttpServer::Response(); });
  ASSERT_THAT(server, IsOk());
  EXPECT_THAT(WaitUntilConnected("learner", Connect((*server)->address()), absl::Seconds(10)),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("speaks HTTP, not gRPC")));
}

// A socket that accepts the connection but never sends anything, like a stopped process.
TEST(WaitUntilConnected, FailsAfterItsTimeout) {
  const TempFolder folder;
  const std::string path = folder / "s";
  const int listener = socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un name = {};
  name.sun_family = AF_UNIX;
  path.copy(name.sun_path, sizeof(name.sun_path) - 1);
  ASSERT_EQ(bind(listener, reinterpret_cast<const sockaddr*>(&name), sizeof(name)), 0);
  ASSERT_EQ(listen(listener, 1), 0);
  const absl::Time start = absl::Now();
  EXPECT_THAT(WaitUntilConnected("learner", Connect("unix:" + path), absl::Milliseconds(300)),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("unix:" + path + ": no answer within 300ms")));
  EXPECT_LT(absl::Now() - start, absl::Seconds(2));
  close(listener);
}

// Answers with a message that is compressed to a thousandth of its size.
class CompressingService : public v1::StatusService::Service {
 public:
  grpc::Status GetStatus(grpc::ServerContext* context, const v1::StatusRequest* /*request*/,
                         v1::StatusReply* reply) override {
    context->set_compression_algorithm(GRPC_COMPRESS_GZIP);
    reply->set_version(std::string(64 << 20, 'x'));
    return grpc::Status::OK;
  }
};

TEST(Channel, RefusesCompressedMessages) {
  CompressingService service;
  int port = 0;
  grpc::ServerBuilder builder;
  builder.RegisterService(&service).AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
  const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  const Endpoint endpoint = Connect(absl::StrCat("127.0.0.1:", port));
  grpc::ClientContext context;
  v1::StatusReply reply;
  EXPECT_THAT(FromCall(v1::StatusService::NewStub(endpoint.channel)->GetStatus(&context, {}, &reply), "x", endpoint),
              StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("gzip")));
}

}  // namespace
}  // namespace craftfleet::wire
