// Hands connections over to a server on threads of their own.

#ifndef CRAFTFLEET_COMMON_WIRE_HAND_OVER_H_
#define CRAFTFLEET_COMMON_WIRE_HAND_OVER_H_

#include <deque>
#include <functional>
#include <thread>
#include <vector>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"

namespace craftfleet::wire {

// gRPC may serve a connection on the thread that hands it over, for as long as the client keeps sending. Meanwhile
// other threads hand others over, and the thread that adds connections goes on. Thread-safe.
class HandOver {
 public:
  // Takes ownership of the descriptor of a connection. Called by one thread at a time.
  using Handle = std::function<void(int descriptor)>;

  // Each of `handles` gets a thread; a connection goes to one that is free. At least one.
  explicit HandOver(std::vector<Handle> handles);
  // Closes the connections that wait; resets those whose hand-over takes another second.
  ~HandOver();

  // Takes ownership of the descriptor; returns at once.
  void Add(int descriptor) ABSL_LOCKS_EXCLUDED(mu_);
  // Resets connections whose hand-over takes longer than `limit`; returns how many.
  int ResetSlow(absl::Duration limit) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Current {
    int copy = -1;  // of the descriptor, which the server may close; -1: none
    absl::Time since;
  };

  void Run(const Handle& handle, Current* current) ABSL_LOCKS_EXCLUDED(mu_);
  bool IsIdle() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  RealClock clock_;
  Mutex mu_;
  CondVar changed_;
  std::deque<int> waiting_ ABSL_GUARDED_BY(mu_);
  std::vector<Current> current_ ABSL_GUARDED_BY(mu_);  // by thread
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::vector<std::thread> threads_;
};

// Ends a connection at once, and discards what the server has not read. After shutdown() it would still read megabytes
// of frames, and go on as long as the client sends.
void ResetConnection(int socket);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_HAND_OVER_H_
