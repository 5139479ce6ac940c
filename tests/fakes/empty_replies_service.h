// An environment server that answers every request with an empty reply, and never ends a stream on its own.

#ifndef CRAFTFLEET_TESTS_FAKES_EMPTY_REPLIES_SERVICE_H_
#define CRAFTFLEET_TESTS_FAKES_EMPTY_REPLIES_SERVICE_H_

#include "craftfleet/v1/environment.grpc.pb.h"

namespace craftfleet {

class EmptyRepliesService : public v1::EnvironmentService::Service {
 public:
  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    v1::PlayRequest request;
    while (stream->Read(&request)) stream->Write({});
    return grpc::Status::OK;
  }
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_EMPTY_REPLIES_SERVICE_H_
