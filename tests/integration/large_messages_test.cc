// Messages that cost many times their bytes when they are parsed are refused before that.

#include <fstream>
#include <memory>
#include <string>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <grpcpp/completion_queue.h>
#include <grpcpp/generic/generic_stub.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "common/wire/grpc_status.h"
#include "tests/fakes/status_matchers.h"
#include "tests/integration/ask_status.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Resident memory, KiB.
int64_t MemoryOf(const Process& process) {
  std::ifstream status(absl::StrCat("/proc/", process.pid(), "/status"));
  for (std::string word; status >> word;) {
    if (word != "VmRSS:") continue;
    status >> word;
    int64_t memory = 0;
    return absl::SimpleAtoi(word, &memory) ? memory : -1;
  }
  return -1;
}

// Sends `bytes` as the request of a call with one request.
absl::Status SendRaw(const std::string& address, const std::string& method, const std::string& bytes) {
  const wire::Endpoint server = wire::Connect(address);
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(60));
  const grpc::Slice slice(bytes);
  const grpc::ByteBuffer request(&slice, 1);
  grpc::CompletionQueue queue;
  grpc::GenericStub stub(server.channel);
  const auto call = stub.PrepareUnaryCall(&context, method, request, &queue);
  call->StartCall();
  grpc::ByteBuffer reply;
  grpc::Status status;
  call->Finish(&reply, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  return wire::FromGrpc(status, "");
}

class LargeMessagesTest : public SmallRunTest {};

// Eight such requests took 1.4 GB, for good.
TEST_F(LargeMessagesTest, AStatusRequestOfEmptyMessagesCostsNothing) {
  const auto server = Start("craftfleet-envserver", {"--listen=127.0.0.1:0"});
  const std::string address = server->WaitForAddress().value();
  ASSERT_THAT(AskStatus(address), IsOk());
  const int64_t before = MemoryOf(*server);
  std::string request;
  for (int i = 0; i < (7 << 20) / 2; ++i) request += std::string("\x0a\0", 2);
  for (int i = 0; i < 8; ++i) {
    EXPECT_THAT(SendRaw(address, "/craftfleet.v1.StatusService/GetStatus", request),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("want at most 65536")));
  }
  EXPECT_LT(MemoryOf(*server) - before, 100 << 10);
  EXPECT_THAT(AskStatus(address), IsOk());
}

}  // namespace
}  // namespace craftfleet
