#include "deploy/cli/screen/terminal_screen.h"

#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>

#include <absl/memory/memory.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int kBarColumns = 8;

constexpr int kWriteTimeout = 1000;  // milliseconds

constexpr absl::Duration kSequenceGap = absl::Milliseconds(50);  // within an escape sequence; longer: the key Escape

// Returns whether all of `text` was written, also to a terminal that another program has made non-blocking.
bool Write(absl::string_view text) {
  while (!text.empty()) {
    const ssize_t count = write(STDOUT_FILENO, text.data(), text.size());
    if (count >= 0) {
      text.remove_prefix(static_cast<size_t>(count));
    } else if (errno == EAGAIN) {
      pollfd output = {STDOUT_FILENO, POLLOUT, 0};
      if (poll(&output, 1, kWriteTimeout) <= 0) return false;
    } else if (errno != EINTR) {
      return false;
    }
  }
  return true;
}

enum class Input { kNone, kSome, kEnd };

// Appends to `bytes` what is typed within `timeout`, or some of it. kEnd: the terminal is gone.
Input Read(absl::Duration timeout, std::string* bytes) {
  pollfd input = {STDIN_FILENO, POLLIN, 0};
  if (poll(&input, 1, static_cast<int>(absl::ToInt64Milliseconds(timeout))) <= 0) return Input::kNone;
  char buffer[64];
  const ssize_t count = read(STDIN_FILENO, buffer, sizeof(buffer));
  if (count > 0) {
    bytes->append(buffer, static_cast<size_t>(count));
    return Input::kSome;
  }
  return count == 0 || (input.revents & (POLLHUP | POLLERR)) != 0 ? Input::kEnd : Input::kNone;
}

// Columns and lines; 80 and 24 if the terminal does not report its size.
std::pair<int, int> TerminalSize() {
  winsize size = {};
  if (ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0 || size.ws_row == 0) return {80, 24};
  return {size.ws_col, size.ws_row};
}

std::string WithStyle(const std::string& text, TextLine::Style style) {
  if (style == TextLine::Style::kPlain) return text;
  const int code = style == TextLine::Style::kTitle ? 1 : style == TextLine::Style::kGood ? 32 : 31;
  return absl::StrFormat("\x1b[%dm%s\x1b[0m", code, text);
}

// Text, bar and percentage.
std::string TextOf(const TextLine& line) {
  if (line.bar == TextLine::kNoBar) return line.text;
  const auto full = static_cast<size_t>(std::lround(line.bar * kBarColumns));
  return absl::StrFormat("%-20s %s %3.0f%%", line.text, std::string(full, '#') + std::string(kBarColumns - full, ' '),
                         100 * line.bar);
}

// The part of the picture that fits.
View Cut(const View& view, int width, int height) {
  View cut;
  cut.width = std::min(view.width, width);
  cut.height = std::min(view.height, height);
  for (int y = 0; y < cut.height; ++y) {
    cut.picture.append(view.picture, size_t{3} * y * view.width, size_t{3} * cut.width);
  }
  return cut;
}

}  // namespace

std::vector<std::string> PageRows(const View& view, int columns, int rows, Colors colors) {
  const View cut = Cut(view, columns, 2 * rows);
  std::vector<std::string> page = HalfBlocks(cut.picture, cut.width, cut.height, colors);
  page.resize(rows, std::string(cut.width, ' '));
  const int text_columns = std::max(0, columns - cut.width - kGapColumns);
  for (size_t i = 0; i < std::min(page.size(), view.lines.size()); ++i) {
    const std::string text = TextOf(view.lines[i]).substr(0, text_columns);
    absl::StrAppend(&page[i], std::string(std::min(kGapColumns, columns - cut.width), ' '),
                    WithStyle(text, view.lines[i].style));
  }
  return page;
}

absl::Status TerminalScreen::Check() {
  if (isatty(STDIN_FILENO) != 1 || isatty(STDOUT_FILENO) != 1) {
    return absl::FailedPreconditionError("--terminal: standard input and output are not a terminal");
  }
  const auto [columns, rows] = TerminalSize();
  if (columns < kLeastColumns || rows < kLeastRows) {
    return absl::FailedPreconditionError(
        absl::StrFormat("--terminal: the terminal has %dx%d characters, want at least %dx%d", columns, rows,
                        kLeastColumns, kLeastRows));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Screen>> TerminalScreen::Open() {
  CRAFTFLEET_RETURN_IF_ERROR(Check());
  return absl::WrapUnique<Screen>(new TerminalScreen());
}

TerminalScreen::TerminalScreen() : colors_(ColorsOf(std::getenv("COLORTERM"), std::getenv("TERM"))) {
  tcgetattr(STDIN_FILENO, &before_);
  termios raw = before_;
  raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO | ISIG);
  raw.c_cc[VMIN] = 0;
  raw.c_cc[VTIME] = 0;
  tcsetattr(STDIN_FILENO, TCSANOW, &raw);
  Write("\x1b[?1049h\x1b[?25l");  // the other screen, no cursor
}

TerminalScreen::~TerminalScreen() {
  Write("\x1b[?25h\x1b[?1049l");
  tcsetattr(STDIN_FILENO, TCSANOW, &before_);
}

PictureRoom TerminalScreen::Room() const {
  const auto [columns, rows] = TerminalSize();
  return {std::max(1, columns - kGapColumns - kTextColumns), std::max(1, 2 * rows)};
}

absl::Status TerminalScreen::Show(const View& view) {
  const auto [columns, rows] = TerminalSize();
  std::vector<std::string> page = PageRows(view, columns, rows, colors_);
  std::string text;
  if (size_ != std::make_pair(columns, rows)) {
    absl::StrAppend(&text, "\x1b[2J");
    shown_.clear();
  }
  shown_.resize(page.size());
  for (size_t i = 0; i < page.size(); ++i) {
    if (page[i] == shown_[i]) continue;
    absl::StrAppend(&text, absl::StrFormat("\x1b[%d;1H", i + 1), page[i], "\x1b[K");
  }
  size_ = Write(text) ? std::pair(columns, rows) : std::pair(0, 0);  // else all of it is drawn the next time
  shown_ = std::move(page);
  return absl::OkStatus();
}

Key TerminalScreen::ReadKey(absl::Duration timeout) {
  if (keys_.empty()) {
    std::string bytes;
    Input input = Read(timeout, &bytes);
    while (input == Input::kSome) {
      for (const Key key : TakeKeys(&bytes)) keys_.push_back(key);
      input = bytes.empty() ? Input::kNone : Read(kSequenceGap, &bytes);
    }
    if (bytes == "\x1b") keys_.push_back(kEscapeKey);
    if (input == Input::kEnd) keys_.push_back(kCloseKey);
  }
  if (keys_.empty()) return kNoKey;
  const Key key = keys_.front();
  keys_.pop_front();
  return key;
}

}  // namespace craftfleet
