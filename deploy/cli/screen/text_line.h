// A styled line of text on a screen.

#ifndef CRAFTFLEET_DEPLOY_CLI_SCREEN_TEXT_LINE_H_
#define CRAFTFLEET_DEPLOY_CLI_SCREEN_TEXT_LINE_H_

#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

struct TextLine {
  enum class Style { kPlain, kTitle, kHeader, kGood, kBad };
  std::string text;  // printable ASCII
  Style style = Style::kPlain;
  double bar =
      kNoBar;  // a part, 0..1, drawn as a bar with its percentage at the right; screens of `craftfleet top` have none

  static constexpr double kNoBar = -1;
};

// `text` with the ANSI escapes of `style` around it.
std::string WithAnsiStyle(absl::string_view text, TextLine::Style style);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SCREEN_TEXT_LINE_H_
