// A terminal that a program draws on.

#ifndef CRAFTFLEET_DEPLOY_TOP_TERMINAL_H_
#define CRAFTFLEET_DEPLOY_TOP_TERMINAL_H_

#include <termios.h>

#include <string>
#include <utility>
#include <vector>

#include <absl/time/time.h>

#include "deploy/top/top_view.h"

namespace craftfleet {

// The page with ANSI escapes for its styles, drawn over the one before.
std::string RenderAnsi(const std::vector<TopLine>& lines);

// Takes over standard input and output, which must be a terminal: keys come one by one and unseen, and what stood there
// comes back with the end of the object. Owned by one thread.
class Terminal {
 public:
  Terminal();
  ~Terminal();
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;

  // Columns and lines; 80 and 24 if the terminal does not say.
  std::pair<int, int> Size() const;
  // Keys pressed within `timeout`; empty: none.
  std::string ReadKeys(absl::Duration timeout) const;
  void Draw(const std::vector<TopLine>& lines) const;

 private:
  termios before_ = {};
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_TOP_TERMINAL_H_
