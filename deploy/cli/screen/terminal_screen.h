// A screen in a terminal, in the colours that it has, also over ssh.

#pragma once

#include <termios.h>

#include <deque>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "deploy/cli/screen/half_blocks.h"
#include "deploy/cli/screen/screen.h"

namespace craftfleet {

// The smallest terminal: room for pictures of two pixels a cell beside the text.
inline constexpr int kGapColumns = 2;
inline constexpr int kLeastColumns = 18 + kGapColumns + kTextColumns;
inline constexpr int kLeastRows = 12;

// The rows of a page: the picture as half blocks, the text beside it, cut to `columns` and `rows`.
std::vector<std::string> PageRows(const View& view, int columns, int rows, Colors colors = Colors::kTrue);

// Keys arrive one by one without echo. The destructor restores the terminal and its content.
class TerminalScreen : public Screen {
 public:
  // Whether standard input and output are a terminal.   FailedPrecondition: they are not, or it is too small.
  static absl::Status Check();
  // Takes over the terminal until the object is destroyed.   Errors as Check.
  static absl::StatusOr<std::unique_ptr<Screen>> Open();
  ~TerminalScreen() override;
  TerminalScreen(const TerminalScreen&) = delete;
  TerminalScreen& operator=(const TerminalScreen&) = delete;

  PictureRoom Room() const override;
  absl::Status Show(const View& view) override;
  Key ReadKey(absl::Duration timeout) override;

 private:
  TerminalScreen();

  const Colors colors_;
  termios before_ = {};
  std::deque<Key> keys_;            // pressed and not read yet
  std::pair<int, int> size_;        // columns and rows when shown_ was drawn
  std::vector<std::string> shown_;  // rows on the terminal: only those that change are written
};

}  // namespace craftfleet
