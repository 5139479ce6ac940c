#include "tests/hostile/bad_env_server.h"

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <absl/time/clock.h>

namespace craftfleet {
namespace {

constexpr absl::Duration kSlowAnswer = absl::Seconds(30);
constexpr absl::Duration kSluggishAnswer = absl::Milliseconds(300);
constexpr size_t kLargeBytes = 32 << 20;
constexpr int kLongestTruth = 40;  // replies of a session before the first lie

// Waits until the client has disconnected.
void WaitForTheEnd(const grpc::ServerContext& context) {
  while (!context.IsCancelled()) absl::SleepFor(absl::Milliseconds(50));
}

}  // namespace

BadEnvService::BadEnvService(Misdeed misdeed, const wire::Endpoint& behind, uint64_t seed)
    : misdeed_(misdeed), behind_(v1::EnvironmentService::NewStub(behind.channel)), random_(seed) {}

int BadEnvService::Draw(int n) {
  const std::lock_guard lock(mu_);
  return std::uniform_int_distribution<int>(0, n - 1)(random_);
}

grpc::Status BadEnvService::Play(grpc::ServerContext* context,
                                 grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) {
  v1::PlayRequest request;
  switch (misdeed_) {
    case Misdeed::kSilent:
      WaitForTheEnd(*context);
      return grpc::Status::CANCELLED;
    case Misdeed::kFlooding: {
      v1::PlayReply reply;
      reply.set_frames(std::string(kLargeBytes, 'x'));
      if (!stream->Read(&request)) return grpc::Status::OK;
      while (stream->Write(reply)) {
      }
      return grpc::Status::OK;
    }
    default:
      return PassOn(context, stream);
  }
}

grpc::Status BadEnvService::PassOn(grpc::ServerContext* context,
                                   grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) {
  grpc::ClientContext behind_context;
  const auto behind = behind_->Play(&behind_context);
  v1::PlayRequest request;
  v1::PlayReply reply;
  int truths = Draw(kLongestTruth);
  while (stream->Read(&request) && behind->Write(request) && behind->Read(&reply)) {
    if (misdeed_ == Misdeed::kSlow) {
      const absl::Time end = absl::Now() + kSlowAnswer;
      while (absl::Now() < end && !context->IsCancelled()) absl::SleepFor(absl::Milliseconds(50));
    } else if (misdeed_ == Misdeed::kSluggish) {
      absl::SleepFor(kSluggishAnswer);
    } else if (misdeed_ == Misdeed::kEndless) {
      reply.mutable_ends()->assign(reply.ends().size(), '\0');
      reply.clear_episodes();
      reply.clear_last_frames();
    } else if (truths-- == 0) {
      Spoil(&reply);
    }
    if (!stream->Write(reply)) break;
  }
  behind_context.TryCancel();
  behind->Finish().IgnoreError();
  return grpc::Status::OK;
}

void BadEnvService::Spoil(v1::PlayReply* reply) {
  if (reply->frames().empty()) return;  // hello and close
  const std::vector<std::function<void()>> lies = {
      [&] { reply->mutable_frames()->pop_back(); },
      [&] { reply->clear_frames(); },
      [&] { reply->mutable_frames()->append(reply->frames()); },
      [&] { reply->add_snapshots(std::string(80 << 20, 'x')); },
      [&] { reply->add_rewards(0); },
      [&] { reply->mutable_ends()->push_back(0); },
      [&] {
        if (reply->rewards_size() > 0) reply->set_rewards(0, std::numeric_limits<float>::quiet_NaN());
        reply->mutable_frames()->pop_back();
      },
      [&] {
        if (reply->rewards_size() > 0) reply->set_rewards(0, 1e6F);
        reply->add_episodes()->set_length(-1);
      },
      [&] { reply->mutable_last_frames()->append("more"); },
  };
  lies[Draw(static_cast<int>(lies.size()))]();
}

}  // namespace craftfleet
