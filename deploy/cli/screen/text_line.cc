#include "deploy/cli/screen/text_line.h"

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

const char* EscapeOf(TextLine::Style style) {
  switch (style) {
    case TextLine::Style::kPlain:
      return "";
    case TextLine::Style::kTitle:
      return "\x1b[1m";
    case TextLine::Style::kHeader:
      return "\x1b[7m";
    case TextLine::Style::kGood:
      return "\x1b[32m";
    case TextLine::Style::kBad:
      return "\x1b[31m";
  }
  return "";
}

}  // namespace

std::string WithAnsiStyle(absl::string_view text, TextLine::Style style) {
  if (style == TextLine::Style::kPlain) return std::string(text);
  return absl::StrCat(EscapeOf(style), text, "\x1b[0m");
}

}  // namespace craftfleet
