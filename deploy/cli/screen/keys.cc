#include "deploy/cli/screen/keys.h"

#include <utility>

#include <absl/strings/ascii.h>

namespace craftfleet {
namespace {

constexpr char kEscape = '\x1b';

// The key of a complete escape sequence that ends with `last`, such as "\x1b[A".
Key ArrowKey(char last) { return last >= 'A' && last <= 'D' ? kUpKey + (last - 'A') : kNoKey; }

// The end of the escape sequence at the beginning of `bytes`, which are "\x1b[" or "\x1bO" and more: parameters and one
// final letter.
size_t EndOfSequence(absl::string_view bytes) {
  size_t end = 2;
  while (end < bytes.size() && (absl::ascii_isdigit(bytes[end]) || bytes[end] == ';')) ++end;
  return end < bytes.size() ? end + 1 : end;
}

Key KeyOfCharacter(char character) {
  if (character == '\x03') return kCloseKey;
  const bool known = absl::ascii_isprint(character) || character == '\t' || character == kEscape;
  return known ? Key{absl::ascii_tolower(character)} : kNoKey;
}

}  // namespace

std::vector<Key> KeysFromTerminal(absl::string_view bytes) {
  std::vector<Key> keys;
  while (!bytes.empty()) {
    const bool sequence = bytes.size() > 1 && bytes[0] == kEscape && (bytes[1] == '[' || bytes[1] == 'O');
    const size_t size = sequence ? EndOfSequence(bytes) : 1;
    const Key key = sequence ? ArrowKey(bytes[size - 1]) : KeyOfCharacter(bytes[0]);
    if (key != kNoKey) keys.push_back(key);
    bytes.remove_prefix(size);
  }
  return keys;
}

Key KeyFromWindow(int code) {
  constexpr std::pair<int, Key> kSymbols[] = {{0xff51, kLeftKey}, {0xff52, kUpKey},  {0xff53, kRightKey},
                                              {0xff54, kDownKey}, {0xff09, kTabKey}, {0xff1b, kEscapeKey}};
  if (code < 0) return kNoKey;
  const int symbol = code & 0xffff;  // modifiers are above
  for (const auto& [known, key] : kSymbols) {
    if (symbol == known) return key;
  }
  return symbol < 128 ? KeyOfCharacter(static_cast<char>(symbol)) : kNoKey;
}

}  // namespace craftfleet
