// Ends streams whose client sends nothing or reads nothing.

#pragma once

#include <atomic>
#include <map>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <grpcpp/server_context.h>

#include "common/base/mutex.h"
#include "common/base/watchdog.h"

namespace craftfleet::wire {

// Keepalive ends connections to dead peers, but a live peer could hold a stream, and the memory and thread that serve
// it, for ever. Each stream states what it waits for and how long; a late one is cancelled with a status that contains
// the reason. Also limits the number of streams of each client. Thread-safe.
class StreamWatch {
 public:
  static constexpr int kMaxPerClient = 2048;                       // half of the calls that a server serves at once
  static constexpr absl::Duration kRequest = absl::Minutes(10);    // for the client's next message
  static constexpr absl::Duration kTakesReply = absl::Minutes(1);  // for the client to receive a message

  explicit StreamWatch(int max_per_client = kMaxPerClient) : max_per_client_(max_per_client) {}

  // One stream while it is served. Used by one thread at a time.
  class Stream {
   public:
    // `context` is the call's; `watch` outlives the object.
    Stream(StreamWatch* watch, grpc::ServerContextBase* context);
    ~Stream();
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;

    // ResourceExhausted: the client has too many streams, and this one must not be served.
    const absl::Status& admitted() const { return admitted_; }
    // Starts a limit, which may be infinite, for the client to do `what` ("a request"); it ends with the next call of
    // Await or Work. `what` is a string literal and names the flag that sets the limit, if there is one.
    void Await(const char* what, absl::Duration limit);
    // Ends the limit: the server is working.
    void Work() { timer_.Disarm(); }
    // DeadlineExceeded, also sent to the client: it was late. OK otherwise.
    absl::Status late() const { return is_late_ ? absl::DeadlineExceededError(LateMessage()) : absl::OkStatus(); }

   private:
    std::string LateMessage() const;

    StreamWatch* const watch_;
    grpc_call* const call_;  // holds a reference; null for a context without a server, as in fuzz targets
    const std::string client_;
    absl::Status admitted_;
    const char* what_ = "";  // like limit_, changed only while the timer, which reads both, is not armed
    absl::Duration limit_;
    std::atomic<bool> is_late_{false};
    Watchdog::Timer timer_;  // the last member: it cancels call_
  };

 private:
  const int max_per_client_;
  Mutex mu_;
  std::map<std::string, int> per_client_ ABSL_GUARDED_BY(mu_);
};

// gRPC's name of a peer ("ipv4:10.0.0.7:4711") without its port: "ipv4:10.0.0.7". All peers of unix sockets are one.
std::string ClientOfPeer(absl::string_view peer);

}  // namespace craftfleet::wire
