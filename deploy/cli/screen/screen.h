// Where a game is shown: a window or a terminal.

#pragma once

#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "deploy/cli/screen/keys.h"

namespace craftfleet {

// A styled line of text.
struct TextLine {
  enum class Style { kPlain, kTitle, kGood, kBad };
  std::string text;  // printable ASCII
  Style style = Style::kPlain;
  double bar = kNoBar;  // a part, 0..1, drawn as a bar with its percentage at the right

  static constexpr double kNoBar = -1;
};

// A picture with a column of text to its right.
struct View {
  int width = 0;                // pixels
  int height = 0;               // pixels
  std::string picture;          // uint8[height,width,3], RGB
  std::vector<TextLine> lines;  // what does not fit is cut off
};

inline constexpr int kTextColumns = 34;  // characters of a line of text that every screen shows

struct PictureRoom {
  int width = 0;   // pixels
  int height = 0;  // pixels
};

// Owned by one thread.
class Screen {
 public:
  virtual ~Screen() = default;

  // The room for pictures beside the text, at the moment; a terminal may change its size.
  virtual PictureRoom Room() const = 0;
  // Replaces what is shown. A larger picture than Room() is cut off.
  //   Internal: the window system failed.
  virtual absl::Status Show(const View& view) = 0;
  // The next key, or kNoKey if none is pressed within `timeout`.
  virtual Key ReadKey(absl::Duration timeout) = 0;
};

}  // namespace craftfleet
