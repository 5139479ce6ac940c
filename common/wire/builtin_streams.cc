#include "common/wire/builtin_streams.h"

#include <grpc/grpc.h>

#include <optional>
#include <string>

#include <absl/strings/match.h>
#include <absl/strings/string_view.h>

#include "common/wire/stream_watch.h"

namespace craftfleet::wire {
namespace {

using grpc::experimental::InterceptionHookPoints;

// One stream, from its beginning until gRPC destroys the interceptor with the call.
class LimitedStream : public grpc::experimental::Interceptor {
 public:
  LimitedStream(StreamWatch* watch, absl::Duration limit, grpc::ServerContextBase* context)
      : watch_(watch), limit_(limit), context_(context) {}

  void Intercept(grpc::experimental::InterceptorBatchMethods* methods) override {
    if (methods->QueryInterceptionHookPoint(InterceptionHookPoints::POST_RECV_INITIAL_METADATA)) Begin();
    methods->Proceed();
  }

 private:
  void Begin() {
    stream_.emplace(watch_, context_);
    if (stream_->admitted().ok()) {
      stream_->Await("the end of the call", limit_);
      return;
    }
    const std::string reason(stream_->admitted().message());
    grpc_call_cancel_with_status(context_->c_call(), GRPC_STATUS_RESOURCE_EXHAUSTED, reason.c_str(), nullptr);
  }

  StreamWatch* const watch_;
  const absl::Duration limit_;
  grpc::ServerContextBase* const context_;
  std::optional<StreamWatch::Stream> stream_;
};

class Factory : public grpc::experimental::ServerInterceptorFactoryInterface {
 public:
  grpc::experimental::Interceptor* CreateServerInterceptor(grpc::experimental::ServerRpcInfo* info) override {
    const absl::string_view method = absl::NullSafeStringView(info->method());
    if (absl::StartsWith(method, "/grpc.reflection.")) {
      return new LimitedStream(&reflections_, kReflection, info->server_context());
    }
    if (method == "/grpc.health.v1.Health/Watch") {
      return new LimitedStream(&health_watchers_, absl::InfiniteDuration(), info->server_context());
    }
    return nullptr;
  }

 private:
  StreamWatch reflections_{kMaxReflections};
  StreamWatch health_watchers_{kMaxHealthWatchers};
};

}  // namespace

std::unique_ptr<grpc::experimental::ServerInterceptorFactoryInterface> LimitBuiltInStreams() {
  return std::make_unique<Factory>();
}

}  // namespace craftfleet::wire
