// The learner's service with a real registry, called by a client.

#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "learner/service/learner_service.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/metric_of.h"
#include "tests/fakes/play_once.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"
#include "tests/learner/service/learner_parts.h"

namespace craftfleet {

inline constexpr int64_t kEpoch = 4;
inline constexpr int64_t kPublishedVersion = 11;

inline LearnerServiceImpl::Options ServiceOptions() {
  LearnerServiceImpl::Options options = SampleServiceOptions(kEpoch, absl::Seconds(5));
  options.config.mutable_env()->set_frame_size(64);
  options.config.mutable_eval()->set_env("crafter:numbers=easy-x2");
  options.config.mutable_eval()->set_seed(7);
  options.texture_digest = "digest";
  return options;
}

// The service with a real registry, called by a client.
class LearnerServiceTest : public testing::Test {
 protected:
  LearnerServiceTest() {
    registry_.OpenIteration(2, kPublishedVersion);
    server_ = *wire::Server::Create({}, {&service_});
    stub_ = v1::LearnerService::NewStub(server_->InProcess().channel);
  }

  // Calls one of the stub's unary methods.
  template <typename Request, typename Reply>
  absl::StatusOr<Reply> Call(grpc::Status (v1::LearnerService::Stub::*method)(grpc::ClientContext*, const Request&,
                                                                              Reply*),
                             const Request& request) {
    grpc::ClientContext context;
    wire::SetDeadline(&context, absl::Seconds(20));
    Reply reply;
    const grpc::Status status = (stub_.get()->*method)(&context, request, &reply);
    if (!status.ok()) return wire::FromGrpc(status, "learner");
    return reply;
  }

  absl::StatusOr<v1::JoinReply> Join(const std::string& actor, const std::string& run_id = "",
                                     int protocol_version = wire::kProtocolVersion) {
    v1::JoinRequest request;
    request.set_protocol_version(protocol_version);
    request.set_run_id(run_id);
    request.set_actor(actor);
    return Call(&v1::LearnerService::Stub::Join, request);
  }
  absl::StatusOr<v1::PermitReply> GetPermits(const std::string& actor, int64_t epoch = kEpoch) {
    v1::PermitRequest request;
    request.set_actor(actor);
    request.set_epoch(epoch);
    request.set_capacity(100);
    return Ask(request);
  }
  absl::StatusOr<v1::PermitReply> Ask(const v1::PermitRequest& request) { return AskOnce(stub_.get(), request); }
  absl::StatusOr<v1::SnapshotReply> GetSnapshot(int lane, int64_t fragment, int64_t epoch = kEpoch) {
    v1::SnapshotRequest request;
    request.set_epoch(epoch);
    request.set_lane(lane);
    request.set_fragment(fragment);
    return Call(&v1::LearnerService::Stub::GetSnapshot, request);
  }
  // Joins and gets all permits.
  void Enter(const std::string& actor) {
    ASSERT_THAT(Join(actor), IsOk());
    const auto permits = GetPermits(actor);
    ASSERT_THAT(permits, IsOk());
    ASSERT_EQ(permits->granted_size(), kSampleShape.lanes);
    EXPECT_EQ(permits->granted(1).lane(), 1);
    EXPECT_EQ(permits->granted(1).fragment(), 0);
    EXPECT_EQ(permits->granted(1).policy_version(), kPublishedVersion);
  }
  // Sends `messages` on one stream. Returns the verdicts, or the error that ended the stream.
  absl::StatusOr<std::vector<v1::FragmentVerdict>> Push(const std::vector<v1::FragmentMessage>& messages) {
    grpc::ClientContext context;
    wire::SetDeadline(&context, absl::Seconds(20));
    const auto stream = stub_->Play(&context);
    std::vector<v1::FragmentVerdict> verdicts;
    v1::ActorMessage message;
    v1::LearnerMessage answer;
    for (const v1::FragmentMessage& fragment : messages) {
      *message.mutable_fragment() = fragment;
      if (stream->Write(message) && stream->Read(&answer)) verdicts.push_back(answer.verdict());
    }
    stream->WritesDone();
    const grpc::Status status = stream->Finish();
    if (!status.ok()) return wire::FromGrpc(status, "learner");
    return verdicts;
  }
  double Metric(const std::string& name) const {
    v1::StatusReply reply;
    service_.FillStatus(&reply);
    return MetricOf(reply, name);
  }

  FakeClock clock_;
  LearnerParts parts_{&clock_};
  TestRegistry& registry_ = parts_.registry;
  WeightStore& weights_ = parts_.weights;
  FragmentQueue& fragments_ = parts_.fragments;
  LearnerServiceImpl service_{ServiceOptions(), &registry_, &weights_, &fragments_};
  std::unique_ptr<wire::Server> server_;
  std::unique_ptr<v1::LearnerService::Stub> stub_;
};

inline v1::FragmentMessage Message(const std::string& actor, int lane, int64_t number,
                                   int64_t version = kPublishedVersion, int64_t epoch = kEpoch) {
  v1::FragmentMessage message = wire::ToProto(SampleFragment(lane, number, version, epoch));
  message.set_actor(actor);
  return message;
}

}  // namespace craftfleet
