// An environment server that fails once.

#ifndef CRAFTFLEET_TESTS_FAKES_FAILING_ONCE_SERVICE_H_
#define CRAFTFLEET_TESTS_FAKES_FAILING_ONCE_SERVICE_H_

#include <atomic>
#include <stdexcept>

#include "common/wire/server.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "envserver/env_service.h"

namespace craftfleet {

// The session after the probe answers `messages` requests and then throws; all other sessions work.
class FailingOnceService : public v1::EnvironmentService::Service {
 public:
  FailingOnceService(EnvServiceImpl* real, int messages) : real_(real), messages_(messages) {}
  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    if (sessions_++ != 1) return real_->Play(context, stream);
    const auto server = *wire::Server::Create({}, {real_});
    const auto stub = v1::EnvironmentService::NewStub(server->InProcess().channel);
    grpc::ClientContext inner_context;
    const auto inner = stub->Play(&inner_context);
    v1::PlayRequest request;
    v1::PlayReply reply;
    for (int i = 0; i < messages_ && stream->Read(&request) && inner->Write(request) && inner->Read(&reply); ++i) {
      stream->Write(reply);
    }
    inner_context.TryCancel();
    inner->Finish();
    throw std::runtime_error("out of pixels");
  }

 private:
  EnvServiceImpl* const real_;
  const int messages_;
  std::atomic<int> sessions_{0};
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_FAILING_ONCE_SERVICE_H_
