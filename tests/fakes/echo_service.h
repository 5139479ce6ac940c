// A service whose sessions answer every request.

#pragma once

#include <atomic>
#include <string>

#include "common/wire/access.h"
#include "craftfleet/v1/environment.grpc.pb.h"

namespace craftfleet::wire {

class EchoService : public v1::EnvironmentService::Service {
 public:
  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    identity_ = Identify(*context);
    v1::PlayRequest request;
    while (stream->Read(&request)) stream->Write({});
    ++ended_;
    return grpc::Status::OK;
  }
  std::string identity() const { return identity_; }  // of the last client; read it after the call
  int ended() const { return ended_; }                // sessions

 private:
  std::string identity_;
  std::atomic<int> ended_{0};
};

}  // namespace craftfleet::wire
