// Workers' names at the learner's service: with TLS, a name belongs to its certificate.

#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "common/wire/access.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"
#include "tests/fakes/wait_until.h"
#include "tests/learner/service/learner_service_fixture.h"

namespace craftfleet {
namespace worker_names_test {

using testing::AllOf;
using testing::HasSubstr;
using Stub = v1::LearnerService::Stub;

class WorkerNamesTest : public LearnerServiceTest {
 protected:
  WorkerNamesTest() {
    for (const char* name : {"learner", "one", "two"}) ca_.Issue(name, {name});
    registry_.AddEvaluation({1, 4096, 1, 2, false, std::make_shared<HostWeights>("weights")});
    Serve(&service_);
  }

  wire::TlsFiles Files(const std::string& name) const {
    return {folder_ / (name + ".pem"), folder_ / (name + ".key"), folder_ / "ca.pem"};
  }
  void Serve(LearnerServiceImpl* service) {
    wire::Server::Options options;
    options.address = "127.0.0.1:0";
    options.files = Files("learner");
    server_ = *wire::Server::Create(options, {service});
  }
  // The calls that follow are of a client with the certificate of `name`.
  void Use(const std::string& name) {
    const wire::ChannelSecurity security = *wire::ChannelSecurity::Create({Files(name), ""});
    stub_ = v1::LearnerService::NewStub(wire::Connect(server_->address(), security).channel);
  }
  absl::Status Leave(const std::string& actor) {
    v1::LeaveRequest request;
    request.set_actor(actor);
    return Call(&Stub::Leave, request).status();
  }
  absl::Status Announce(const std::string& name, const std::string& address, bool leaving = false) {
    v1::Announcement request;
    request.set_protocol_version(wire::kProtocolVersion);
    request.set_name(name);
    request.set_address(address);
    request.set_leaving(leaving);
    return Call(&Stub::Announce, request).status();
  }

  const TempFolder folder_;
  TestAuthority ca_{folder_, "ca"};
};

TEST_F(WorkerNamesTest, NoWorkerCanUseAnothersName) {
  const auto denied = [](const std::string& text) {
    return StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr(text));
  };
  Use("one");
  Enter("a");
  const int permits = registry_.permits();
  ASSERT_THAT(Announce("server", "10.0.0.1:50061"), IsOk());

  Use("two");
  testing::internal::CaptureStderr();
  const auto another = denied("actor \"a\" belongs to another certificate");
  EXPECT_THAT(Join("a"), another);
  EXPECT_THAT(GetPermits("a"), another);
  EXPECT_THAT(Push({Message("a", 1, 0)}), another);
  v1::EvaluationResult result;
  result.set_actor("a");
  result.set_epoch(kEpoch);
  result.set_id(2);
  EXPECT_THAT(Call(&Stub::FinishEvaluation, result), another);
  EXPECT_THAT(Leave("a"), another);
  EXPECT_THAT(Announce("server", "10.0.0.2:50061"), denied("environment server \"server\" belongs to another"));
  EXPECT_THAT(Announce("server", "10.0.0.1:50061", /*leaving=*/true), denied("\""));
  EXPECT_THAT(Announce("mine", "10.0.0.1:50061"), denied("\"10.0.0.1:50061\" belongs to another certificate"));
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("refused certificate 127.0.0.1, "),  // in any order
                    HasSubstr("two"), HasSubstr(": actor \"a\" belongs to another certificate")));
  EXPECT_EQ(registry_.permits(), permits) << "it has lost nothing";
  ASSERT_EQ(registry_.Servers().size(), 1);
  EXPECT_EQ(registry_.Servers()[0].name, "server");

  // Under its own name it may do all of that.
  Use("one");
  EXPECT_THAT(Push({Message("a", 1, 0)}), IsOk());
  EXPECT_THAT(Leave("a"), IsOk());
  EXPECT_THAT(Announce("server", "10.0.0.1:50061", /*leaving=*/true), IsOk());
  Use("two");
  EXPECT_THAT(Join("a"), IsOk()) << "the name is free";
  EXPECT_THAT(Announce("mine", "10.0.0.1:50061"), IsOk());
}

TEST_F(WorkerNamesTest, ARenewedCertificateIsTheSameWorker) {
  Use("one");
  ASSERT_THAT(Join("a"), IsOk());
  ca_.Issue("one", {"one", 77});
  Use("one");
  EXPECT_THAT(GetPermits("a"), IsOk());
}

TEST_F(WorkerNamesTest, AStreamEndsOnceItsClientIsNoLongerAllowed) {
  ASSERT_THAT(WriteFileSynced(folder_ / "access.txt", R"(client { name: "x" certificate: "one" right: PLAY })"),
              IsOk());
  LearnerServiceImpl::Options options = ServiceOptions();
  options.access = wire::AccessControl::Create(folder_ / "access.txt").value();
  LearnerServiceImpl service(options, &registry_, &parts_.weights, &parts_.fragments);
  Serve(&service);
  Use("one");
  ASSERT_THAT(Join("a"), IsOk());
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(60));
  const auto stream = stub_->Play(&context);
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

}  // namespace worker_names_test
}  // namespace craftfleet
