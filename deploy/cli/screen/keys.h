// Keys as programs with a screen see them, the same from a window and from a terminal.

#pragma once

#include <string>
#include <vector>

namespace craftfleet {

// The ASCII code of a key, letters in lower case, or one of the constants below.
using Key = int;
inline constexpr Key kNoKey = 0;
inline constexpr Key kTabKey = '\t';
inline constexpr Key kEscapeKey = 27;
inline constexpr Key kUpKey = 256;  // the arrows in the order of terminals' escape sequences
inline constexpr Key kDownKey = 257;
inline constexpr Key kRightKey = 258;
inline constexpr Key kLeftKey = 259;
inline constexpr Key kCloseKey = 260;  // Ctrl-C in a terminal, or the terminal or window was closed

// Takes the keys from `bytes` of a terminal, but leaves an escape sequence at the end that may continue, such as
// "\x1b". Unknown sequences are skipped.
std::vector<Key> TakeKeys(std::string* bytes);

// The key of a code from OpenCV's waitKeyEx: ASCII or, for arrows, an X11 symbol; kNoKey for others and for -1.
Key KeyFromWindow(int code);

}  // namespace craftfleet
