// Whether the other side has closed or reset a connection.

#ifndef CRAFTFLEET_TESTS_FAKES_IS_CLOSED_H_
#define CRAFTFLEET_TESTS_FAKES_IS_CLOSED_H_

#include <sys/socket.h>

#include <cerrno>

namespace craftfleet {

inline bool IsClosed(int client) {
  char byte = 0;
  const ssize_t received = recv(client, &byte, 1, MSG_DONTWAIT | MSG_PEEK);
  return received == 0 || (received < 0 && errno == ECONNRESET);
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_IS_CLOSED_H_
