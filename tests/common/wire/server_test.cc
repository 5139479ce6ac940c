#include "common/wire/server.h"

#include <unistd.h>

#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <grpcpp/completion_queue.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/support/byte_buffer.h>
#include <gtest/gtest.h>

#include "common/process/version.h"
#include "common/wire/grpc_status.h"
#include "common/wire/status_service.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "tests/fakes/echo_service.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// Without `services`, with any: gRPC starts no server without one.
std::unique_ptr<Server> Listen(const std::string& address, std::vector<grpc::Service*> services = {}) {
  static auto* const any = new v1::EnvironmentService::Service;
  if (services.empty()) services.push_back(any);
  auto server = Server::Create({address}, services);
  EXPECT_THAT(server, IsOk());
  return server.ok() ? *std::move(server) : nullptr;
}

// The next event must be a success.
bool Next(grpc::CompletionQueue* queue) {
  void* tag = nullptr;
  bool ok = false;
  return queue->Next(&tag, &ok) && ok;
}

// Sends one message to `method` and returns the first reply, like a client without the project's protos.
absl::StatusOr<std::string> Call(const Endpoint& server, const std::string& method, const std::string& request) {
  grpc::GenericStub stub(server.channel);
  grpc::ClientContext context;
  SetDeadline(&context, absl::Seconds(10));
  grpc::CompletionQueue queue;
  const auto call = stub.PrepareCall(&context, method, &queue);
  const grpc::Slice slice(request);
  grpc::ByteBuffer reply;
  call->StartCall(nullptr);
  if (Next(&queue)) {
    call->Write(grpc::ByteBuffer(&slice, 1), nullptr);
    Next(&queue);
    call->WritesDone(nullptr);
    Next(&queue);
    call->Read(&reply, nullptr);
    Next(&queue);
  }
  grpc::Status status;
  call->Finish(&status, nullptr);
  Next(&queue);
  if (!status.ok()) return FromGrpc(status, method);
  std::vector<grpc::Slice> slices;
  if (!reply.Dump(&slices).ok()) return absl::InternalError("no reply");
  std::string bytes;
  for (const grpc::Slice& part : slices) bytes.append(reinterpret_cast<const char*>(part.begin()), part.size());
  return bytes;
}

TEST(Server, ListensOnAHostName) {
  const auto server = Listen("localhost:0");
  EXPECT_THAT(server->address(), testing::MatchesRegex("localhost:[1-9][0-9]*"));
  // By number: c-ares, with which a client resolves names, leaks some bytes.
  const std::string port = server->address().substr(server->address().rfind(':'));
  EXPECT_THAT(WaitUntilConnected("server", Connect("127.0.0.1" + port), absl::Seconds(10)), IsOk());
  EXPECT_THAT(Server::Create({server->address()}, {}),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("--listen: cannot listen on " + server->address())));
}

TEST(Server, ListensOnAUnixSocket) {
  const TempFolder folder;
  const auto server = Listen("unix:" + (folder / "s"));
  EXPECT_EQ(server->address(), "unix:" + (folder / "s"));
  EXPECT_THAT(WaitUntilConnected("server", Connect(server->address()), absl::Seconds(10)), IsOk());
}

// Such as in a folder that Jenkins named after a branch. The server listened on "sA", or could not listen.
TEST(Server, ListensOnAUnixSocketWhosePathHasPercentSigns) {
  const TempFolder folder;
  const auto server = Listen("unix:" + (folder / "s%41"));
  ASSERT_THAT(server, testing::NotNull());
  EXPECT_EQ(access((folder / "s%41").c_str(), F_OK), 0);
  EXPECT_THAT(WaitUntilConnected("server", Connect(server->address()), absl::Seconds(10)), IsOk());
  EXPECT_THAT(Server::Create({server->address()}, {}), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("another")));
}

TEST(Server, ReleasesItsPortOnDestruction) {
  const std::string address = Listen("127.0.0.1:0")->address();
  EXPECT_EQ(Listen(address)->address(), address);
}

TEST(Server, RefusesToListenBeyondThisHostByDefault) {
  for (const char* address : {"0.0.0.0:0", "[::]:0", "10.0.0.1:80", "learner:80", "127.example.com:80",
                              "127.0.0.1.example.com:80", "localhost.example.com:80"}) {
    EXPECT_THAT(Server::Create({address}, {}),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr("--listen=" + std::string(address)), HasSubstr("--insecure"))));
    EXPECT_THAT((Server::Options{address, /*insecure=*/true}.Validate()), IsOk());
  }
  for (const char* address : {"127.0.0.1:0", "127.1.2.3:0", "localhost:0", "[::1]:0", "unix:x", ""}) {
    EXPECT_THAT(Server::Options{address}.Validate(), IsOk()) << address;
  }
}

TEST(Server, RefusesAnInvalidAddress) {
  EXPECT_THAT(Server::Create({"127.0.0.1"}, {}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--listen: \"127.0.0.1\"")));
}

// The call of `grpc_health_probe`: grpc.health.v1.
TEST(Server, ReportsThatItIsHealthy) {
  const auto server = Listen("127.0.0.1:0");
  const auto reply = Call(Connect(server->address()), "/grpc.health.v1.Health/Check", /*of the whole server*/ "");
  ASSERT_THAT(reply, IsOk());
  EXPECT_EQ(*reply, "\x08\x01");  // status: SERVING
}

TEST(Server, StopDoesNotWaitForStreamsBeyondItsTimeout) {
  EchoService service;
  const auto server = Listen("127.0.0.1:0", {&service});
  grpc::ClientContext context;
  const Endpoint endpoint = Connect(server->address());
  const auto stub = v1::EnvironmentService::NewStub(endpoint.channel);
  const auto stream = stub->Play(&context);
  v1::PlayReply reply;
  ASSERT_TRUE(stream->Write({}));
  ASSERT_TRUE(stream->Read(&reply));

  std::thread waiting([&server] { server->Wait(); });
  const absl::Time start = absl::Now();
  EXPECT_TRUE(server->serving());
  server->Stop(absl::Milliseconds(100));
  EXPECT_FALSE(server->serving());
  waiting.join();
  EXPECT_LT(absl::Now() - start, absl::Seconds(3));
  EXPECT_FALSE(stream->Read(&reply));
  EXPECT_FALSE(stream->Finish().ok());
  server->Stop(absl::Milliseconds(100));
}

}  // namespace
}  // namespace craftfleet::wire
