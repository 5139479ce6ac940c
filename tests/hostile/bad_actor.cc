#include "tests/hostile/bad_actor.h"

#include <functional>
#include <limits>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>

#include "common/agent/canary.h"
#include "common/base/status_macros.h"
#include "common/process/version.h"
#include "common/process/worker_name.h"
#include "common/wire/channel.h"
#include "common/wire/protocol.h"
#include "tests/fakes/play_once.h"

namespace craftfleet {
namespace {

constexpr int kFloodThreads = 8;
constexpr size_t kLargeBytes = 64 << 20;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

}  // namespace

BadActor::BadActor(const wire::Endpoint& learner, uint64_t seed)
    : endpoint_(learner),
      learner_(learner),
      stub_(v1::LearnerService::NewStub(learner.channel)),
      random_(seed),
      name_(UniqueWorkerName()) {}

absl::Status BadActor::Join() {
  v1::JoinRequest request;
  request.set_protocol_version(wire::kProtocolVersion);
  request.set_actor(name_);
  request.set_build(BuildId());
  CRAFTFLEET_ASSIGN_OR_RETURN(*request.mutable_canary(), PolicyCanary());
  CRAFTFLEET_ASSIGN_OR_RETURN(joined_, learner_.Join(request));
  CRAFTFLEET_ASSIGN_OR_RETURN(spec_, MakeAgentSpec(joined_.config()));
  return absl::OkStatus();
}

absl::StatusOr<v1::PermitReply> BadActor::AskForPermits(int capacity) {
  v1::PermitRequest request;
  request.set_actor(name_);
  request.set_epoch(joined_.epoch());
  request.set_capacity(capacity);
  request.set_wait_ms(200);
  return AskOnce(stub_.get(), request);
}

void BadActor::StaySilent() {
  while (true) {
    absl::SleepFor(absl::Milliseconds(200));
    if (!Join().ok()) continue;
    v1::PermitRequest request;
    request.set_actor(name_);
    request.set_epoch(joined_.epoch());
    request.set_capacity(4096);
    request.set_evaluates(true);
    request.set_wait_ms(200);
    absl::StatusOr<v1::PermitReply> reply = AskOnce(stub_.get(), request);
    while (reply.ok() && !reply->finished()) {
      for (const v1::Permit& permit : reply->granted()) {
        *request.add_active() = permit;
      }
      if (reply->has_evaluation()) request.set_evaluation(reply->evaluation().id());
      absl::SleepFor(absl::Milliseconds(200));
      reply = AskOnce(stub_.get(), request);
    }
    if (reply.ok()) return;
  }
}

void BadActor::Lie() {
  while (true) {
    absl::SleepFor(absl::Milliseconds(100));
    if (!Join().ok()) continue;
    const absl::StatusOr<v1::PermitReply> reply = AskForPermits(4096);
    if (reply.ok() && reply->finished()) return;
    if (reply.ok()) {
      for (const v1::Permit& permit : reply->granted()) SendLie(permit);
    }
    SayNonsense();
  }
}

v1::FragmentMessage BadActor::Fragment(const v1::Permit& permit) const {
  const int steps = joined_.config().fragment_steps();
  v1::FragmentMessage message;
  message.set_actor(name_);
  message.set_epoch(joined_.epoch());
  message.set_lane(permit.lane());
  message.set_number(permit.fragment());
  message.set_policy_version(permit.policy_version());
  message.set_frames(std::string(steps * spec_.frame_bytes(), '\0'));
  message.set_actions(std::string(steps, '\0'));
  for (int t = 0; t < steps; ++t) {
    message.add_log_probs(-2.8F);
    message.add_values(0);
    message.add_rewards(0);
  }
  message.set_ends(std::string(steps, '\0'));
  message.set_snapshot("no game at all");
  return message;
}

// Each of these changes alone makes the fragment invalid; the snapshot is always invalid.
void BadActor::Spoil(v1::FragmentMessage* message) {
  const std::vector<std::function<void()>> lies = {
      [&] { message->set_log_probs(0, 40); },
      [&] { message->set_log_probs(0, kNan); },
      [&] { message->set_values(0, 3e38F); },
      [&] { message->set_rewards(0, 1e6F); },
      [&] { message->set_bootstrap_value(kNan); },
      [&] {
        for (float& reward : *message->mutable_rewards()) reward = 1.9F;
      },
      [&] { message->mutable_actions()->at(0) = 17; },
      [&] { message->mutable_ends()->at(0) = 3; },
      [&] { message->mutable_ends()->at(0) = 1; },
      [&] { message->mutable_frames()->pop_back(); },
      [&] { message->set_snapshot(std::string(80 << 20, 'x')); },
      [&] { message->clear_snapshot(); },
      [&] { message->set_lane(message->lane() + 100000); },
      [&] { message->set_lane(-1); },
      [&] { message->set_number(message->number() + 1); },
      [&] { message->set_policy_version(message->policy_version() + 1); },
      [&] { message->set_epoch(message->epoch() + 1); },
      [&] { message->add_states(kNan); },
      [&] {
        v1::EpisodeMessage* episode = message->add_episodes();
        episode->set_length(int64_t{1} << 62);
        episode->set_reward(1e300);
      },
      [] {},
  };
  lies[Draw(static_cast<int>(lies.size()))]();
}

void BadActor::SendLie(const v1::Permit& permit) {
  v1::FragmentMessage message = Fragment(permit);
  Spoil(&message);
  PushOnce(stub_.get(), std::move(message)).status().IgnoreError();
}

void BadActor::SayNonsense() {
  v1::PermitRequest request;
  request.set_actor(name_);
  request.set_epoch(joined_.epoch());
  request.set_capacity(Draw(2) == 0 ? -1 : std::numeric_limits<int32_t>::max());
  for (int i = 0; i < 1000; ++i) {
    v1::Permit* permit = request.add_active();
    permit->set_lane(Draw(2) == 0 ? i : -i);
    permit->set_fragment(Draw(10));
  }
  request.mutable_summary()->set_last_error(std::string(1 << 20, '\x1b'));
  AskOnce(stub_.get(), request).status().IgnoreError();
  PlayOnce(stub_.get(), v1::ActorMessage()).status().IgnoreError();

  v1::EvaluationResult result;
  result.set_actor(name_);
  result.set_epoch(joined_.epoch());
  result.set_id(1 + Draw(5));
  result.add_episodes()->set_reward(1e300);
  learner_.FinishEvaluation(result).IgnoreError();

  learner_.Leave(absl::StrCat(name_, "-of-another"));
}

void BadActor::FloodOnce() {
  const wire::Endpoint apart = wire::ConnectApart(endpoint_);
  const LearnerClient client(apart);
  v1::JoinRequest request;
  request.set_protocol_version(wire::kProtocolVersion);
  request.set_actor(UniqueWorkerName());
  client.Join(request).IgnoreError();

  const auto stub = v1::LearnerService::NewStub(apart.channel);
  grpc::ClientContext downloads[4];
  std::vector<std::unique_ptr<grpc::ClientReader<v1::WeightsChunk>>> unread;
  unread.reserve(std::size(downloads));
  for (grpc::ClientContext& context : downloads) {
    wire::SetDeadline(&context, absl::Seconds(10));
    unread.push_back(stub->GetWeights(&context, v1::WeightsRequest()));
  }
  grpc::ClientContext push;
  wire::SetDeadline(&push, absl::Seconds(10));
  const auto stream = client.Play(&push);
  v1::ActorMessage message;
  message.mutable_fragment()->set_actor(request.actor());
  message.mutable_fragment()->set_frames(std::string(kLargeBytes, 'x'));
  while (stream->Write(message)) absl::SleepFor(absl::Milliseconds(50));
  push.TryCancel();
  stream->Finish().IgnoreError();
  for (size_t i = 0; i < unread.size(); ++i) {
    downloads[i].TryCancel();
    unread[i]->Finish().IgnoreError();
  }
}

void BadActor::Flood() {
  std::vector<std::thread> threads;
  threads.reserve(kFloodThreads);
  for (int i = 0; i < kFloodThreads; ++i) {
    threads.emplace_back([this] {
      while (true) {
        FloodOnce();
        absl::SleepFor(absl::Milliseconds(100));
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace craftfleet
