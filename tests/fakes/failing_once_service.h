// An environment server that fails once.

#pragma once

#include <atomic>
#include <memory>
#include <stdexcept>

#include "common/wire/server.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "envserver/env_service.h"

namespace craftfleet {

// Passes sessions on to the real service. The session after the probe answers `messages` requests and then throws.
class FailingOnceService : public v1::EnvironmentService::Service {
 public:
  FailingOnceService(EnvServiceImpl* real, int messages)
      : real_(*wire::Server::Create({}, {real})),
        stub_(v1::EnvironmentService::NewStub(real_->InProcess().channel)),
        messages_(messages) {}
  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    const bool fails = sessions_++ == 1;
    grpc::ClientContext inner_context;
    const auto inner = stub_->Play(&inner_context);
    v1::PlayRequest request;
    v1::PlayReply reply;
    for (int i = 0; (!fails || i < messages_) && stream->Read(&request) && inner->Write(request); ++i) {
      if (!inner->Read(&reply) || !stream->Write(reply)) break;
    }
    if (fails) inner_context.TryCancel();
    inner->WritesDone();
    const grpc::Status end = inner->Finish();
    if (fails) throw std::runtime_error("out of pixels");
    return end;
  }

 private:
  const std::unique_ptr<wire::Server> real_;
  const std::unique_ptr<v1::EnvironmentService::Stub> stub_;
  const int messages_;
  std::atomic<int> sessions_{0};
};

}  // namespace craftfleet
