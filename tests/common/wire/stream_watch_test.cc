#include "common/wire/stream_watch.h"

#include <memory>
#include <string>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "common/wire/grpc_status.h"
#include "common/wire/server.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet::wire {
namespace {

using testing::HasSubstr;

// Answers each request; clients have `limit` for the next one.
class WatchedService : public v1::EnvironmentService::Service {
 public:
  explicit WatchedService(absl::Duration limit, int max_per_client = StreamWatch::kMaxPerClient)
      : limit_(limit), watch_(max_per_client) {}

  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    StreamWatch::Stream watched(&watch_, context);
    if (!watched.admitted().ok()) return ToGrpc(watched.admitted());
    v1::PlayRequest request;
    while (true) {
      watched.Await("a word", limit_);
      if (!stream->Read(&request)) break;
      watched.Work();
      if (request.has_close()) absl::SleepFor(2 * limit_);  // simulated work
      stream->Write({});
    }
    late_ = watched.late();
    return grpc::Status::OK;
  }

  absl::Status late() const { return late_; }

 private:
  const absl::Duration limit_;
  StreamWatch watch_;
  absl::Status late_;
};

class Client {
 public:
  explicit Client(const Server& server) : stub_(v1::EnvironmentService::NewStub(Connect(server.address()).channel)) {
    SetDeadline(&context_, absl::Seconds(60));
    stream_ = stub_->Play(&context_);
  }
  bool Say(const v1::PlayRequest& request = {}) {
    v1::PlayReply reply;
    return stream_->Write(request) && stream_->Read(&reply);
  }
  // Waits for the end of the stream and returns its status.
  absl::Status End() {
    v1::PlayReply reply;
    while (stream_->Read(&reply)) {
    }
    return FromGrpc(stream_->Finish(), "end");
  }
  void Leave() { stream_->WritesDone(); }

 private:
  const std::unique_ptr<v1::EnvironmentService::Stub> stub_;
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::PlayRequest, v1::PlayReply>> stream_;
};

std::unique_ptr<Server> Listen(WatchedService* service) { return *Server::Create({"127.0.0.1:0"}, {service}); }

TEST(StreamWatch, EndsASilentStreamWithTheReason) {
  WatchedService service(absl::Seconds(1));
  auto server = Listen(&service);
  Client client(*server);
  ASSERT_TRUE(client.Say());
  EXPECT_THAT(client.End(), StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("waited 1s for a word")));
  server.reset();  // waits for the service
  EXPECT_THAT(service.late(), StatusIs(absl::StatusCode::kDeadlineExceeded, "waited 1s for a word"));
}

TEST(StreamWatch, DoesNotLimitTheServersOwnWork) {
  WatchedService service(absl::Seconds(1));
  const auto server = Listen(&service);
  Client client(*server);
  v1::PlayRequest work;
  work.mutable_close();
  EXPECT_TRUE(client.Say(work));
  client.Leave();
  EXPECT_THAT(client.End(), IsOk());
  EXPECT_THAT(service.late(), IsOk());
}

TEST(StreamWatch, AnInfiniteLimitNeverEndsAStream) {
  WatchedService service(absl::InfiniteDuration());
  const auto server = Listen(&service);
  Client client(*server);
  ASSERT_TRUE(client.Say());
  absl::SleepFor(absl::Seconds(1));
  EXPECT_TRUE(client.Say());
  client.Leave();
  EXPECT_THAT(client.End(), IsOk());
}

TEST(StreamWatch, LimitsTheStreamsOfAClient) {
  WatchedService service(absl::InfiniteDuration(), /*max_per_client=*/2);
  const auto server = Listen(&service);
  auto first = std::make_unique<Client>(*server);
  Client second(*server);
  ASSERT_TRUE(first->Say());
  ASSERT_TRUE(second.Say());
  EXPECT_THAT(Client(*server).End(),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("ipv4:127.0.0.1 has 2 streams here already")));
  first->Leave();
  ASSERT_THAT(first->End(), IsOk());
  EXPECT_TRUE(Client(*server).Say());
}

TEST(StreamWatch, AClientIsItsAddressWithoutThePort) {
  EXPECT_EQ(ClientOfPeer("ipv4:10.0.0.7:4711"), "ipv4:10.0.0.7");
  EXPECT_EQ(ClientOfPeer("ipv6:%5B::1%5D:4711"), "ipv6:%5B::1%5D");
  EXPECT_EQ(ClientOfPeer("unix:/tmp/s"), "unix");
  EXPECT_EQ(ClientOfPeer("inproc"), "inproc");
}

}  // namespace
}  // namespace craftfleet::wire
