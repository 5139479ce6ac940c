// Finds connections whose clients flood a server with HTTP/2 frames that take memory and are no calls.

#ifndef CRAFTFLEET_COMMON_WIRE_CONNECTION_WATCH_H_
#define CRAFTFLEET_COMMON_WIRE_CONNECTION_WATCH_H_

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <absl/time/time.h>

namespace craftfleet::wire {

// What one connection holds at the moment.
struct ConnectionLoad {
  int descriptor = -1;
  std::string client;            // its address, without the port
  int64_t streams = 0;           // started and not destroyed yet, even if the client has reset them
  int64_t unfinished_bytes = 0;  // received since the last stream began or the last message was complete
};

struct ConnectionLimits {
  int64_t streams = 256;                // of a connection
  int64_t client_streams = 4096;        // of all connections of one client; a stream takes some 13 KB
  int64_t unfinished_bytes = 0;         // of a connection: the largest message, and some headers
  int64_t client_unfinished_bytes = 0;  // of all connections of one client
};

// The connections to end, with the reasons. A client beyond its own limits loses those connections that hold most.
std::map<int, std::string> FindFloods(std::vector<ConnectionLoad> loads, const ConnectionLimits& limits);

// gRPC 1.51 applies its limits of streams and headers only after the client has acknowledged them, which a hostile
// client does not, and does not count streams that the client has reset. This looks at gRPC's own counters (channelz)
// and the kernel's. Thread-compatible.
class ConnectionWatch {
 public:
  // Watches the server that this process was the last to build.
  explicit ConnectionWatch(const ConnectionLimits& limits);

  // `connections`: the client of each descriptor. Returns those to end, as FindFloods. Takes about 10 us for each.
  std::map<int, std::string> Look(const std::map<int, std::string>& connections);

 private:
  // The bytes that a connection had received when a stream last began or a message was last complete, and those that
  // need no message.
  struct Progress {
    int64_t count = 0;  // of streams and messages
    int64_t bytes = 0;
  };

  const ConnectionLimits limits_;
  const int64_t server_;  // channelz' number
  absl::Time last_look_;
  std::map<std::string, Progress> progress_;  // of each connection, by its peer
};

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_CONNECTION_WATCH_H_
