// What an actor knows of its environment servers, for status pages.

#ifndef CRAFTFLEET_ACTOR_SERVER_BOOK_H_
#define CRAFTFLEET_ACTOR_SERVER_BOOK_H_

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "common/mutex.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Loops write what they see, others read it put together. Thread-safe.
class ServerBook {
 public:
  struct Server {
    std::string address;
    bool connected = false;
    int lanes = 0;               // games that the loop has there
    v1::ProcessSummary summary;  // as the server last told it
    std::string trouble;         // why it is left alone, since it does not answer; empty: it is not
  };

  // What loop number `loop` sees now, in place of what it saw before.
  void Update(int loop, std::vector<Server> servers) ABSL_LOCKS_EXCLUDED(mu_);

  // All servers: reached by one loop at least, NOT_ANSWERING, or LOST. Those without games of ours are without a
  // summary.
  std::vector<v1::Peer> All() const ABSL_LOCKS_EXCLUDED(mu_);
  // At most `count` of them, the next ones each time.
  std::vector<v1::Peer> Next(size_t count) ABSL_LOCKS_EXCLUDED(mu_);
  // The same of those that are NOT_ANSWERING.
  std::vector<v1::Peer> NextNotAnswering(size_t count) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // At most `count` of `all`, from the one after that where the last call ended.
  std::vector<v1::Peer> Rotate(std::vector<v1::Peer> all, size_t count) ABSL_LOCKS_EXCLUDED(mu_);

  mutable Mutex mu_;
  std::map<int, std::vector<Server>> seen_ ABSL_GUARDED_BY(mu_);  // by loop
  std::string last_ ABSL_GUARDED_BY(mu_);                         // address where Next ended
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_SERVER_BOOK_H_
