#include "deploy/cli/screen/keys.h"

#include <utility>

#include <absl/strings/ascii.h>
#include <absl/strings/string_view.h>

namespace craftfleet {
namespace {

constexpr char kEscape = '\x1b';

// The key of a complete escape sequence, such as "\x1b[A".
Key ArrowKey(absl::string_view sequence) {
  const char last = sequence.back();
  return last >= 'A' && last <= 'D' && sequence[2] != '[' ? kUpKey + (last - 'A') : kNoKey;
}

// The size of the character or escape sequence at the beginning of `bytes`. A sequence is "\x1b[" or "\x1bO",
// parameters and one final letter; 0: it may continue.
size_t SizeOfFirst(absl::string_view bytes) {
  if (bytes[0] != kEscape) return 1;
  if (bytes.size() == 1) return 0;
  if (bytes[1] != '[' && bytes[1] != 'O') return 1;
  if (bytes.size() > 2 && bytes[2] == '[') return bytes.size() > 3 ? 4 : 0;  // "\x1b[[A": F1 of Linux' console
  size_t end = 2;
  while (end < bytes.size() && (absl::ascii_isdigit(bytes[end]) || bytes[end] == ';')) ++end;
  return end < bytes.size() ? end + 1 : 0;
}

Key KeyOfCharacter(char character) {
  if (character == '\x03') return kCloseKey;
  const bool known = absl::ascii_isprint(character) || character == '\t' || character == kEscape;
  return known ? Key{absl::ascii_tolower(character)} : kNoKey;
}

}  // namespace

std::vector<Key> TakeKeys(std::string* bytes) {
  std::vector<Key> keys;
  absl::string_view rest = *bytes;
  while (!rest.empty()) {
    const size_t size = SizeOfFirst(rest);
    if (size == 0) break;
    const Key key = size > 1 ? ArrowKey(rest.substr(0, size)) : KeyOfCharacter(rest[0]);
    if (key != kNoKey) keys.push_back(key);
    rest.remove_prefix(size);
  }
  bytes->erase(0, bytes->size() - rest.size());
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
