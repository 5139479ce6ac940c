// An environment server that misbehaves.

#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <random>

#include "common/wire/channel.h"
#include "craftfleet/v1/environment.grpc.pb.h"

namespace craftfleet {

enum class Misdeed {
  kSilent,    // accepts every request and answers none
  kSlow,      // forwards each reply of the server behind it after 30 s
  kSluggish,  // forwards each reply after 0.3 s
  kEndless,   // forwards the replies of the server behind it, but no end of an episode
  kLying,     // forwards the replies of the server behind it until it corrupts one reply of a session
  kFlooding,  // answers a request with endless large replies
};

// Forwards sessions to `behind`, a well-behaved server. Thread-safe.
class BadEnvService : public v1::EnvironmentService::Service {
 public:
  BadEnvService(Misdeed misdeed, const wire::Endpoint& behind, uint64_t seed);

  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override;

 private:
  grpc::Status PassOn(grpc::ServerContext* context, grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream);
  // Makes the reply invalid, in a way that clients can detect.
  void Spoil(v1::PlayReply* reply);
  int Draw(int n);

  const Misdeed misdeed_;
  const std::unique_ptr<v1::EnvironmentService::Stub> behind_;
  std::mutex mu_;
  std::mt19937_64 random_;  // guarded by mu_
};

}  // namespace craftfleet
