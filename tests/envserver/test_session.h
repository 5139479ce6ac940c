// Sessions with an environment server in the test's process, for tests of its service.

#pragma once

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "tests/fakes/metric_of.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {

inline constexpr int kLength = 60;  // of an episode

inline v1::PlayRequest Hello(const std::string& run_id) {
  v1::PlayRequest request;
  v1::SessionHello* hello = request.mutable_hello();
  hello->set_protocol_version(wire::kProtocolVersion);
  hello->set_run_id(run_id);
  static const std::string digest = *TextureDigest(*DefaultTextureDir());
  hello->set_texture_digest(digest);
  hello->mutable_env()->set_name("crafter");
  hello->mutable_env()->set_frame_size(64);
  hello->mutable_env()->set_length(kLength);
  hello->set_client("a test");
  return request;
}

inline v1::PlayRequest Open(int lane, int64_t seed, const std::string& snapshot = "") {
  v1::PlayRequest request;
  v1::OpenLanes::Lane* message = request.mutable_open()->add_lanes();
  message->set_lane(lane);
  message->set_seed(seed);
  message->set_snapshot(snapshot);
  return request;
}

inline v1::PlayRequest OpenMany(int lanes) {
  v1::PlayRequest request;
  for (int lane = 0; lane < lanes; ++lane) request.mutable_open()->add_lanes()->set_lane(lane);
  return request;
}

inline v1::PlayRequest Step(const std::vector<int>& lanes, const std::string& actions, bool snapshot = false) {
  v1::PlayRequest request;
  request.mutable_step()->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  request.mutable_step()->set_actions(actions);
  request.mutable_step()->set_snapshot(snapshot);
  return request;
}

// A session that may send anything.
class Session {
 public:
  explicit Session(const wire::Endpoint& server) : stub_(v1::EnvironmentService::NewStub(server.channel)) {
    wire::SetDeadline(&context_, absl::Seconds(60));
    stream_ = stub_->Play(&context_);
  }

  // The reply, or the status with which the server ended the session.
  absl::StatusOr<v1::PlayReply> Send(const v1::PlayRequest& request) {
    Write(request);
    return Read();
  }
  void Write(const v1::PlayRequest& request) { written_ = stream_->Write(request); }
  absl::StatusOr<v1::PlayReply> Read() {
    v1::PlayReply reply;
    if (written_ && stream_->Read(&reply)) return reply;
    const absl::Status end = wire::FromGrpc(stream_->Finish(), "server");
    return end.ok() ? absl::InternalError("the session ended without an error") : end;
  }
  void Leave() {
    stream_->WritesDone();
    EXPECT_TRUE(stream_->Finish().ok());
  }

 private:
  grpc::ClientContext context_;
  const std::unique_ptr<v1::EnvironmentService::Stub> stub_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::PlayRequest, v1::PlayReply>> stream_;
  bool written_ = true;
};

// A well-behaved session on lane 7, compared with the same game played without a server.
class Witness {
 public:
  explicit Witness(const wire::Endpoint& server) : session_(server) {
    EXPECT_THAT(session_.Send(Hello("run-a")), IsOk());
    const auto opened = session_.Send(Open(7, 77));
    EXPECT_THAT(opened, IsOk());
    EXPECT_EQ(opened->frames(), played_.frame);
  }

  void PlayOn(int steps) {
    for (int i = 0; i < steps; ++i) {
      const int action = (++steps_ * 5) % kNumActions;
      const auto reply = session_.Send(Step({7}, std::string(1, static_cast<char>(action)), true));
      ASSERT_THAT(reply, IsOk());
      played_.last_frames.clear();
      const Game::PlayedStep played = played_.Step(static_cast<Action>(action));
      ASSERT_EQ(reply->frames(), played_.frame) << "step " << steps_;
      ASSERT_EQ(reply->last_frames(), played_.last_frames);
      ASSERT_EQ(reply->rewards(0), static_cast<float>(played.outcome.reward));
      ASSERT_EQ(reply->ends()[0], static_cast<char>(played.outcome.end));
      ASSERT_EQ(reply->episodes_size(), played.episode.has_value() ? 1 : 0);
      if (played.episode.has_value()) {
        ASSERT_EQ(reply->episodes(0).length(), played.episode->length);
      }
      ASSERT_EQ(reply->snapshots(0), played_.game.Save());
    }
  }

 private:
  Session session_;
  PlayedGame played_{MakeRenderer(kLength), 77};
  int steps_ = 0;
};

// The value of a metric that the service reports; -1: none.
inline double Metric(const EnvServiceImpl& service, absl::string_view name) {
  v1::StatusReply status;
  service.FillStatus(&status);
  return MetricOf(status, name);
}

class EnvServiceTest : public testing::Test {
 protected:
  EnvServiceTest()
      : service_(*EnvServiceImpl::Create(*DefaultTextureDir())), server_(*wire::Server::Create({}, {service_.get()})) {}

  wire::Endpoint server() { return server_->InProcess(); }
  v1::StatusReply Status() const {
    v1::StatusReply reply;
    service_->FillStatus(&reply);
    return reply;
  }

  const std::unique_ptr<EnvServiceImpl> service_;
  const std::unique_ptr<wire::Server> server_;
};

}  // namespace craftfleet
