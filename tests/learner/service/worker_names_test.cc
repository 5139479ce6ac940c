// Workers' names at the learner's service: with TLS, a name belongs to its certificate.

#include <memory>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "common/wire/access.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "learner/service/learner_service.h"
#include "tests/fakes/play_once.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"
#include "tests/fakes/wait_until.h"
#include "tests/fakes/wire_samples.h"
#include "tests/learner/service/learner_parts.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr int64_t kEpoch = 4;
constexpr int64_t kVersion = 11;

class WorkerNamesTest : public testing::Test {
 protected:
  WorkerNamesTest() {
    for (const char* name : {"learner", "one", "two"}) ca_.Issue(name, {name});
    registry_.OpenIteration(2, kVersion);
    registry_.AddEvaluation({1, 4096, 1, 2, false, std::make_shared<std::string>("weights")});
  }

  wire::TlsFiles Files(const std::string& name) const {
    return {folder_ / (name + ".pem"), folder_ / (name + ".key"), folder_ / "ca.pem"};
  }
  // A client with the certificate of `name`; "": without TLS.
  std::unique_ptr<v1::LearnerService::Stub> Client(const std::string& name) {
    if (server_ == nullptr) {
      wire::Server::Options options;
      options.address = "127.0.0.1:0";
      if (!name.empty()) options.files = Files("learner");
      server_ = *wire::Server::Create(options, {&service_});
    }
    wire::ChannelSecurity security;
    if (!name.empty()) security = *wire::ChannelSecurity::Create({Files(name), "", ""});
    return v1::LearnerService::NewStub(wire::Connect(server_->address(), security).channel);
  }

  static absl::Status Join(v1::LearnerService::Stub* stub, const std::string& actor) {
    v1::JoinRequest request;
    request.set_protocol_version(wire::kProtocolVersion);
    request.set_actor(actor);
    return Call<v1::JoinReply>(stub, &v1::LearnerService::Stub::Join, request);
  }
  static absl::Status GetPermits(v1::LearnerService::Stub* stub, const std::string& actor) {
    v1::PermitRequest request;
    request.set_actor(actor);
    request.set_epoch(kEpoch);
    request.set_capacity(100);
    return AskOnce(stub, request).status();
  }
  static absl::Status Push(v1::LearnerService::Stub* stub, const std::string& actor) {
    v1::FragmentMessage message = wire::ToProto(SampleFragment(1, 0, kVersion, kEpoch));
    message.set_actor(actor);
    return PushOnce(stub, std::move(message)).status();
  }
  static absl::Status FinishEvaluation(v1::LearnerService::Stub* stub, const std::string& actor) {
    v1::EvaluationResult request;
    request.set_actor(actor);
    request.set_epoch(kEpoch);
    request.set_id(2);
    return Call<v1::EvaluationReply>(stub, &v1::LearnerService::Stub::FinishEvaluation, request);
  }
  static absl::Status Leave(v1::LearnerService::Stub* stub, const std::string& actor) {
    v1::LeaveRequest request;
    request.set_actor(actor);
    return Call<v1::LeaveReply>(stub, &v1::LearnerService::Stub::Leave, request);
  }
  static absl::Status Announce(v1::LearnerService::Stub* stub, const std::string& name, const std::string& address,
                               bool leaving = false) {
    v1::Announcement request;
    request.set_protocol_version(wire::kProtocolVersion);
    request.set_name(name);
    request.set_address(address);
    request.set_leaving(leaving);
    return Call<v1::AnnounceReply>(stub, &v1::LearnerService::Stub::Announce, request);
  }

  static LearnerServiceImpl::Options ServiceOptions() { return SampleServiceOptions(kEpoch, absl::Minutes(5)); }

  int Permits(const std::string& actor) {
    for (const LaneTable::ActorInfo& info : registry_.Actors()) {
      if (info.name == actor) return info.permits;
    }
    return -1;
  }

  const TempFolder folder_;
  TestAuthority ca_{folder_, "ca"};
  RealClock clock_;
  LearnerParts parts_{&clock_};
  TestRegistry& registry_ = parts_.registry;
  LearnerServiceImpl service_{ServiceOptions(), &registry_, &parts_.weights, &parts_.fragments};
  std::unique_ptr<wire::Server> server_;

 private:
  template <typename Reply, typename Request>
  static absl::Status Call(v1::LearnerService::Stub* stub,
                           grpc::Status (v1::LearnerService::Stub::*method)(grpc::ClientContext*, const Request&,
                                                                            Reply*),
                           const Request& request) {
    grpc::ClientContext context;
    wire::SetDeadline(&context, absl::Seconds(20));
    context.set_wait_for_ready(true);
    Reply reply;
    return wire::FromGrpc((stub->*method)(&context, request, &reply), "learner");
  }
};

TEST_F(WorkerNamesTest, NoWorkerCanUseAnothersName) {
  const auto one = Client("one");
  const auto two = Client("two");
  ASSERT_THAT(Join(one.get(), "a"), IsOk());
  ASSERT_THAT(GetPermits(one.get(), "a"), IsOk());
  const int permits = Permits("a");
  ASSERT_GT(permits, 0);
  ASSERT_THAT(Announce(one.get(), "server", "10.0.0.1:50061"), IsOk());

  const auto denied =
      StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("actor \"a\" belongs to another certificate"));
  EXPECT_THAT(Join(two.get(), "a"), denied);
  EXPECT_THAT(GetPermits(two.get(), "a"), denied);
  EXPECT_THAT(Push(two.get(), "a"), denied);
  EXPECT_THAT(FinishEvaluation(two.get(), "a"), denied);
  EXPECT_THAT(Leave(two.get(), "a"), denied);
  EXPECT_THAT(
      Announce(two.get(), "server", "10.0.0.2:50061"),
      StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("environment server \"server\" belongs to another")));
  EXPECT_THAT(Announce(two.get(), "server", "10.0.0.1:50061", /*leaving=*/true),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"")));
  EXPECT_THAT(
      Announce(two.get(), "mine", "10.0.0.1:50061"),
      StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"10.0.0.1:50061\" belongs to another certificate")));
  EXPECT_EQ(Permits("a"), permits) << "it has lost nothing";
  ASSERT_EQ(registry_.Servers().size(), 1);
  EXPECT_EQ(registry_.Servers()[0].name, "server");

  // Under its own name it may do all of that.
  EXPECT_THAT(Push(one.get(), "a"), IsOk());
  EXPECT_THAT(Leave(one.get(), "a"), IsOk());
  EXPECT_THAT(Announce(one.get(), "server", "10.0.0.1:50061", /*leaving=*/true), IsOk());
  EXPECT_THAT(Join(two.get(), "a"), IsOk()) << "the name is free";
  EXPECT_THAT(Announce(two.get(), "mine", "10.0.0.1:50061"), IsOk());
}

TEST_F(WorkerNamesTest, ARenewedCertificateIsTheSameWorker) {
  ASSERT_THAT(Join(Client("one").get(), "a"), IsOk());
  ca_.Issue("one", {"one", 77});
  EXPECT_THAT(GetPermits(Client("one").get(), "a"), IsOk());
}

TEST_F(WorkerNamesTest, AStreamEndsOnceItsClientIsNoLongerAllowed) {
  ASSERT_THAT(WriteFileSynced(folder_ / "access.txt", R"(client { name: "x" certificate: "one" right: PLAY })"),
              IsOk());
  LearnerServiceImpl::Options options = ServiceOptions();
  options.access = wire::AccessControl::Create(folder_ / "access.txt").value();
  LearnerServiceImpl service(options, &registry_, &parts_.weights, &parts_.fragments);
  wire::Server::Options server;
  server.address = "127.0.0.1:0";
  server.files = Files("learner");
  server_ = *wire::Server::Create(server, {&service});
  const auto stub = Client("one");
  ASSERT_THAT(Join(stub.get(), "a"), IsOk());
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(60));
  const auto stream = stub->Play(&context);
  v1::ActorMessage message;
  message.mutable_permits()->set_actor("a");
  message.mutable_permits()->set_epoch(kEpoch);
  v1::LearnerMessage answer;
  ASSERT_TRUE(stream->Write(message) && stream->Read(&answer));
  ASSERT_THAT(ReplaceFile(folder_ / "access.txt", R"(client { name: "x" certificate: "two" right: PLAY })"), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return !stream->Write(message) || !stream->Read(&answer); }));
  EXPECT_THAT(wire::FromGrpc(stream->Finish(), "learner"),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("not allowed")));
  server_.reset();  // before its service
}

TEST_F(WorkerNamesTest, WithoutTlsNamesAreNotOwned) {
  ASSERT_THAT(Join(Client("").get(), "a"), IsOk());
  EXPECT_THAT(Leave(Client("").get(), "a"), IsOk());
}

}  // namespace
}  // namespace craftfleet
