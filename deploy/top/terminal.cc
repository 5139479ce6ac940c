#include "deploy/top/terminal.h"

#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

namespace craftfleet {
namespace {

void Write(absl::string_view text) {
  while (!text.empty()) {
    const ssize_t count = write(STDOUT_FILENO, text.data(), text.size());
    if (count <= 0) return;
    text.remove_prefix(static_cast<size_t>(count));
  }
}

const char* EscapeOf(TopLine::Style style) {
  switch (style) {
    case TopLine::Style::kPlain:
      return "";
    case TopLine::Style::kTitle:
      return "\x1b[1m";
    case TopLine::Style::kHeader:
      return "\x1b[7m";
    case TopLine::Style::kGood:
      return "\x1b[32m";
    case TopLine::Style::kBad:
      return "\x1b[31m";
  }
  return "";
}

}  // namespace

std::string RenderAnsi(const std::vector<TopLine>& lines) {
  std::string text = "\x1b[H";  // home
  for (size_t i = 0; i < lines.size(); ++i) {
    const std::string escape = EscapeOf(lines[i].style);
    // Each line clears what is left of an older, longer one.
    absl::StrAppend(&text, i == 0 ? "" : "\r\n", escape, lines[i].text, escape.empty() ? "" : "\x1b[0m", "\x1b[K");
  }
  return text + "\x1b[J";
}

Terminal::Terminal() {
  tcgetattr(STDIN_FILENO, &before_);
  termios raw = before_;
  raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO | ISIG);
  raw.c_cc[VMIN] = 0;
  raw.c_cc[VTIME] = 0;
  tcsetattr(STDIN_FILENO, TCSANOW, &raw);
  Write("\x1b[?1049h\x1b[?25l");  // the other screen, no cursor
}

Terminal::~Terminal() {
  Write("\x1b[?25h\x1b[?1049l");
  tcsetattr(STDIN_FILENO, TCSANOW, &before_);
}

std::pair<int, int> Terminal::Size() const {
  winsize size = {};
  if (ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0 || size.ws_row == 0) return {80, 24};
  return {size.ws_col, size.ws_row};
}

std::string Terminal::ReadKeys(absl::Duration timeout) const {
  pollfd input = {STDIN_FILENO, POLLIN, 0};
  if (poll(&input, 1, static_cast<int>(absl::ToInt64Milliseconds(timeout))) <= 0) return "";
  char bytes[64];
  const ssize_t count = read(STDIN_FILENO, bytes, sizeof(bytes));
  return {bytes, static_cast<size_t>(count > 0 ? count : 0)};
}

void Terminal::Draw(const std::vector<TopLine>& lines) const { Write(RenderAnsi(lines)); }

}  // namespace craftfleet
