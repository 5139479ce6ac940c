// Full-screen output to a terminal.

#ifndef CRAFTFLEET_DEPLOY_CLI_SCREEN_TERMINAL_H_
#define CRAFTFLEET_DEPLOY_CLI_SCREEN_TERMINAL_H_

#include <termios.h>

#include <string>
#include <utility>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

namespace craftfleet {

// Switches the terminal at standard input and output to full-screen mode: keys arrive one by one without echo. The
// destructor restores the terminal and its content. Owned by one thread.
class Terminal {
 public:
  Terminal();
  ~Terminal();
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;

  // Columns and lines; 80 and 24 if the terminal does not report its size.
  static std::pair<int, int> Size();
  // The keys pressed within `timeout`; empty if there were none.
  std::string ReadKeys(absl::Duration timeout) const;
  // Writes text with ANSI escapes.
  void Write(absl::string_view text) const;

 private:
  termios before_ = {};
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SCREEN_TERMINAL_H_
