#include "deploy/cli/screen/terminal_screen.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <absl/memory/memory.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

constexpr int kGapColumns = 2;
constexpr int kLeastRows = 12;
constexpr int kLeastColumns = 18 + kGapColumns + kTextColumns;

constexpr int kBarColumns = 8;

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

std::vector<std::string> PageRows(const View& view, int columns, int rows, Colours colours) {
  const View cut = Cut(view, columns, 2 * rows);
  std::vector<std::string> page = HalfBlocks(cut.picture, cut.width, cut.height, colours);
  page.resize(rows, std::string(cut.width, ' '));
  const int text_columns = std::max(0, columns - cut.width - kGapColumns);
  for (size_t i = 0; i < std::min(page.size(), view.lines.size()); ++i) {
    const std::string text = TextOf(view.lines[i]).substr(0, text_columns);
    absl::StrAppend(&page[i], std::string(std::min(kGapColumns, columns - cut.width), ' '),
                    WithAnsiStyle(text, view.lines[i].style));
  }
  return page;
}

absl::StatusOr<std::unique_ptr<Screen>> TerminalScreen::Open() {
  if (isatty(STDIN_FILENO) != 1 || isatty(STDOUT_FILENO) != 1) {
    return absl::FailedPreconditionError("--terminal: standard input and output are not a terminal");
  }
  const auto [columns, rows] = Terminal::Size();
  if (columns < kLeastColumns || rows < kLeastRows) {
    return absl::FailedPreconditionError(
        absl::StrFormat("--terminal: the terminal has %dx%d characters, want at least %dx%d", columns, rows,
                        kLeastColumns, kLeastRows));
  }
  return absl::WrapUnique<Screen>(new TerminalScreen());
}

TerminalScreen::TerminalScreen() : colours_(ColoursOf(std::getenv("COLORTERM"), std::getenv("TERM"))) {}

PictureRoom TerminalScreen::Room() const {
  const auto [columns, rows] = Terminal::Size();
  return {std::max(1, columns - kGapColumns - kTextColumns), std::max(1, 2 * rows)};
}

absl::Status TerminalScreen::Show(const View& view) {
  const auto [columns, rows] = Terminal::Size();
  std::vector<std::string> page = PageRows(view, columns, rows, colours_);
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
  terminal_.Write(text);
  size_ = {columns, rows};
  shown_ = std::move(page);
  return absl::OkStatus();
}

Key TerminalScreen::ReadKey(absl::Duration timeout) {
  if (keys_.empty()) {
    for (const Key key : KeysFromTerminal(terminal_.ReadKeys(timeout))) keys_.push_back(key);
  }
  if (keys_.empty()) return kNoKey;
  const Key key = keys_.front();
  keys_.pop_front();
  return key;
}

}  // namespace craftfleet
