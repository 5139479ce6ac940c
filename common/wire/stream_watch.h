// Ends streams whose client says nothing or takes nothing.

#ifndef CRAFTFLEET_COMMON_WIRE_STREAM_WATCH_H_
#define CRAFTFLEET_COMMON_WIRE_STREAM_WATCH_H_

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <thread>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <grpcpp/server_context.h>

#include "common/mutex.h"

namespace craftfleet::wire {

// Keepalive ends connections whose other side is dead; a peer that lives may hold a stream, with the thread that serves
// it, for ever. Each stream says for what it waits and how long it may; what is late is cancelled with a status that
// says why. Also counts the streams of each client. Thread-safe; a thread of its own while there are streams to watch.
class StreamWatch {
 public:
  static constexpr int kMaxPerClient = 2048;                       // half of the calls that a server serves at once
  static constexpr absl::Duration kRequest = absl::Minutes(10);    // for the next message of a client that has a stream
  static constexpr absl::Duration kTakesReply = absl::Minutes(1);  // for a message to be taken

  explicit StreamWatch(int max_per_client = kMaxPerClient) : max_per_client_(max_per_client) {}
  ~StreamWatch();

  // One stream, as long as it is served; for the handler's thread.
  class Stream {
   public:
    // `context` is the call's; `watch` outlives the object.
    Stream(StreamWatch* watch, grpc::ServerContext* context);
    ~Stream();
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;

    // ResourceExhausted: the client has too many streams; this one is not to be served.
    const absl::Status& admitted() const { return admitted_; }
    // Until the next call of Await or Work the client has `limit`, which may be infinite, to do `what` ("a request");
    // it names the flag, if there is one, that sets the limit. `what` is a literal.
    void Await(const char* what, absl::Duration limit);
    // The server works now: no limit.
    void Work() { deadline_ns_ = 0; }
    // DeadlineExceeded, as the client is told: it was late. Ok: not so.
    absl::Status late() const ABSL_LOCKS_EXCLUDED(watch_->mu_);

   private:
    friend class StreamWatch;
    std::string Complaint() const;

    StreamWatch* const watch_;
    grpc::ServerContext* const context_;
    const std::string client_;
    absl::Status admitted_;
    std::atomic<int64_t> deadline_ns_{0};  // of the steady clock; 0: none
    std::atomic<int64_t> limit_ns_{0};
    std::atomic<const char*> what_{""};
  };

  int size() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  void CancelLate() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const int max_per_client_;
  mutable Mutex mu_;
  CondVar changed_;
  std::map<const Stream*, bool> streams_ ABSL_GUARDED_BY(mu_);  // whether it was late and is cancelled
  std::map<std::string, int> per_client_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  bool started_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

// A peer as gRPC names it ("ipv4:10.0.0.7:4711") without its port: "ipv4:10.0.0.7". The same for all of a unix socket.
std::string ClientOfPeer(absl::string_view peer);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_STREAM_WATCH_H_
