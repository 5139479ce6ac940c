// An environment server that misbehaves.

#ifndef CRAFTFLEET_TESTS_HOSTILE_BAD_ENV_SERVER_H_
#define CRAFTFLEET_TESTS_HOSTILE_BAD_ENV_SERVER_H_

#include <cstdint>
#include <memory>
#include <mutex>
#include <random>

#include "common/wire/channel.h"
#include "craftfleet/v1/environment.grpc.pb.h"

namespace craftfleet {

enum class Misdeed {
  kSilent,    // takes every request and answers none
  kSlow,      // answers as the server behind it does, each time after 30 s
  kLying,     // hands on what the server behind it says, until it spoils one reply of a session
  kFlooding,  // answers a request with replies without end, large ones
};

// Passes sessions on to `behind`, a server as it should be. Thread-safe.
class BadEnvService : public v1::EnvironmentService::Service {
 public:
  BadEnvService(Misdeed misdeed, const wire::Endpoint& behind, uint64_t seed);

  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override;

 private:
  grpc::Status PassOn(grpc::ServerContext* context, grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream);
  // Makes of it what no server may say. What can't be told from the truth is left alone.
  void Spoil(v1::PlayReply* reply);
  int Draw(int n);

  const Misdeed misdeed_;
  const std::unique_ptr<v1::EnvironmentService::Stub> behind_;
  std::mutex mu_;
  std::mt19937_64 random_;  // guarded by mu_
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_HOSTILE_BAD_ENV_SERVER_H_
