// The costs of frames: from an environment server to an actor, and from there to a learner. Both ends are in this
// process: the client's thread is the actor, the other threads are the server.

#include <algorithm>
#include <cstdint>
#include <ctime>
#include <memory>
#include <numeric>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <absl/time/clock.h>
#include <absl/types/span.h>

#include "actor/env_client.h"
#include "actor/fragment_builder.h"
#include "common/agent/agent_spec.h"
#include "common/base/status_macros.h"
#include "common/io/paths.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "deploy/cli/plan/measure.h"
#include "envserver/env_service.h"
#include "learner/fragment_frames.h"
#include "learner/runnable_config.h"

namespace craftfleet {
namespace {

constexpr char kAnyPort[] = "127.0.0.1:0";
constexpr absl::Duration kPatience = absl::Seconds(10);
constexpr absl::Duration kGrace = absl::Milliseconds(200);

double CpuMicros(clockid_t clock) {
  timespec time = {};
  clock_gettime(clock, &time);
  return 1e6 * static_cast<double>(time.tv_sec) + 1e-3 * static_cast<double>(time.tv_nsec);
}

// CPU time since its making: of the calling thread, and of all other threads.
class CpuTimer {
 public:
  double own_us() const { return CpuMicros(CLOCK_THREAD_CPUTIME_ID) - own_; }
  double others_us() const { return CpuMicros(CLOCK_PROCESS_CPUTIME_ID) - all_ - own_us(); }

 private:
  const double all_ = CpuMicros(CLOCK_PROCESS_CPUTIME_ID);
  const double own_ = CpuMicros(CLOCK_THREAD_CPUTIME_ID);
};

// Receives fragments as a learner does, and drops them.
class Intake final : public v1::LearnerService::Service {
 public:
  Intake(const v1::RunConfig& config, const std::string& texture_digest, const wire::FragmentShape& shape)
      : frames_(config, texture_digest), shape_(shape) {}

  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::LearnerMessage, v1::ActorMessage>* stream) override {
    v1::ActorMessage message;
    while (stream->Read(&message)) {
      absl::Status status = frames_.Draw(shape_.steps, message.mutable_fragment());
      if (status.ok()) status = wire::FromProto(message.mutable_fragment(), shape_).status();
      if (!status.ok()) return {grpc::StatusCode::INVALID_ARGUMENT, std::string(status.message())};
      v1::LearnerMessage answer;
      answer.mutable_verdict()->set_verdict(v1::FragmentVerdict::ACCEPTED);
      if (!stream->Write(answer)) break;
    }
    return grpc::Status::OK;
  }

 private:
  const FragmentFrames frames_;
  const wire::FragmentShape shape_;
};

// Plays games with random actions, as an actor's thread does.
class RandomPlayer {
 public:
  RandomPlayer(const wire::Endpoint& server, const v1::SessionHello& hello, FrameFormat format, int lanes,
               const wire::FragmentShape& shape)
      : client_(server, hello, shape.frame_bytes), format_(format), lanes_(lanes), actions_(lanes), shape_(shape) {
    std::iota(lanes_.begin(), lanes_.end(), 0);
  }

  absl::Status Begin() {
    CRAFTFLEET_RETURN_IF_ERROR(client_.Connect(kPatience));
    std::vector<EnvClient::Lane> open;
    for (const int lane : lanes_) open.push_back({lane, lane, 1, ""});
    return client_.Open(open, &frames_);
  }

  // Plays a fragment of each lane, and returns that of the first.
  absl::StatusOr<v1::FragmentMessage> PlayFragment() {
    const bool scene = format_ == FrameFormat::kScene;
    FragmentBuilder builder;
    builder.Start(0, 0, 0, 0, shape_.steps, shape_.frame_bytes, format_);
    const std::vector<float> state(shape_.state_size);
    for (int t = 0; t < shape_.steps; ++t) {
      const std::string frame = scene ? client_.records()[0] : frames_.substr(0, shape_.frame_bytes);
      if (t < shape_.states) builder.AddState(state);
      for (Action& action : actions_) action = static_cast<Action>(random_() % kNumActions);
      CRAFTFLEET_RETURN_IF_ERROR(client_.SendStep(lanes_, actions_, /*snapshot=*/t + 1 == shape_.steps));
      CRAFTFLEET_RETURN_IF_ERROR(client_.ReceiveStep(&batch_));
      builder.Append(frame, actions_[0], -2.833F, 0, batch_.rewards[0], StepEnd::kNone);
      busy_ += client_.busy();
      frames_.swap(batch_.frames);
    }
    steps_ += static_cast<int64_t>(shape_.steps) * static_cast<int64_t>(lanes_.size());
    return wire::ToProto(builder.Finish(0, {std::move(batch_.snapshots[0]), state}));
  }

  void Leave() { client_.Leave(); }

  int64_t steps() const { return steps_; }
  // Of the server, between requests and replies.
  absl::Duration busy() const { return busy_; }

 private:
  EnvClient client_;
  const FrameFormat format_;
  std::vector<int> lanes_;
  std::vector<Action> actions_;
  const wire::FragmentShape shape_;
  std::mt19937 random_{1};
  std::string frames_;  // the present observations
  StepBatch batch_;
  int64_t steps_ = 0;
  absl::Duration busy_;
};

// Adds to `costs` those of sending `message` to a learner.
absl::Status MeasureIntake(const v1::ActorMessage& message, int steps, Intake* intake, absl::Duration duration,
                           FrameCosts* costs) {
  wire::Server::Options options;
  options.address = kAnyPort;
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto server, wire::Server::Create(options, {intake}));
  const wire::Endpoint endpoint = wire::Connect(server->address());
  const auto stub = v1::LearnerService::NewStub(endpoint.channel);
  grpc::ClientContext context;
  const auto stream = stub->Play(&context);
  v1::LearnerMessage answer;
  bool connected = stream->Write(message) && stream->Read(&answer);
  const CpuTimer timer;
  int64_t sent = 0;
  for (const absl::Time end = absl::Now() + duration; connected && (absl::Now() < end || sent == 0); ++sent) {
    connected = stream->Write(message) && stream->Read(&answer);
  }
  const double actor_us = timer.own_us();
  const double learner_us = timer.others_us();
  stream->WritesDone();
  const grpc::Status status = stream->Finish();
  server->Stop(kGrace);
  if (!connected || !status.ok()) return wire::FromCall(status, "measuring", endpoint);
  const auto all_steps = static_cast<double>(sent * steps);
  costs->actor_us += actor_us / all_steps;
  costs->learner_us = learner_us / all_steps;
  costs->bytes = static_cast<double>(message.ByteSizeLong()) / steps;
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<FrameCosts> MeasureGames(const v1::RunConfig& config, FrameFormat format, absl::Duration duration) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  const wire::FragmentShape shape = FragmentShapeOf(config, spec);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, DefaultTextureDir());
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto service, EnvServiceImpl::Create(textures));
  wire::Server::Options options;
  options.address = kAnyPort;
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto server, wire::Server::Create(options, {service.get()}));
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  hello.set_texture_digest(service->texture_digest());
  *hello.mutable_env() = config.env();
  if (format != FrameFormat::kRaw) hello.add_frame_formats(static_cast<v1::FrameFormat>(format));

  RandomPlayer player(wire::Connect(server->address()), hello, format, std::min(config.lanes(), config.tile()), shape);
  CRAFTFLEET_RETURN_IF_ERROR(player.Begin());
  FrameCosts costs;
  const CpuTimer timer;
  v1::ActorMessage message;
  for (const absl::Time end = absl::Now() + duration / 2; absl::Now() < end || player.steps() == 0;) {
    CRAFTFLEET_ASSIGN_OR_RETURN(*message.mutable_fragment(), player.PlayFragment());
  }
  const auto steps = static_cast<double>(player.steps());
  costs.actor_us = timer.own_us() / steps;
  costs.server_us = timer.others_us() / steps;
  // Elapsed time, which other work on the machine lengthens.
  costs.game_us = std::min(absl::ToDoubleMicroseconds(player.busy()) / steps, costs.server_us);
  player.Leave();
  server->Stop(kGrace);
  Intake intake(config, service->texture_digest(), shape);
  CRAFTFLEET_RETURN_IF_ERROR(MeasureIntake(message, shape.steps, &intake, duration / 2, &costs));
  return costs;
}

}  // namespace craftfleet
