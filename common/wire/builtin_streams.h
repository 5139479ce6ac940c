// Limits the streams of gRPC's own services, whose handlers cannot register with StreamWatch.

#ifndef CRAFTFLEET_COMMON_WIRE_BUILTIN_STREAMS_H_
#define CRAFTFLEET_COMMON_WIRE_BUILTIN_STREAMS_H_

#include <memory>

#include <absl/time/time.h>
#include <grpcpp/support/server_interceptor.h>

namespace craftfleet::wire {

// Reflection holds a thread for each stream, as long as the client likes. Tools need it for a moment.
inline constexpr int kMaxReflections = 16;  // streams of one client
inline constexpr absl::Duration kReflection = absl::Seconds(10);
// A watcher of the health costs no thread, only memory, and may stay.
inline constexpr int kMaxHealthWatchers = 256;  // of one client

// Ends streams beyond these limits: RESOURCE_EXHAUSTED if the client has too many, DEADLINE_EXCEEDED if one lasts too
// long. Other calls are unaffected.
std::unique_ptr<grpc::experimental::ServerInterceptorFactoryInterface> LimitBuiltInStreams();

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_BUILTIN_STREAMS_H_
