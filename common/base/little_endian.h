// Numbers as bytes, the least significant first, on any CPU.

#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Appends the sizeof(T) bytes of `value` to `out`.
template <typename T>
void AppendLittleEndian(T value, std::string* out) {
  static_assert(std::is_integral_v<T>);
  const auto bits = static_cast<std::make_unsigned_t<T>>(value);
  for (size_t i = 0; i < sizeof(T); ++i) out->push_back(static_cast<char>(bits >> (8 * i)));
}

// Decodes `bytes`, at most sizeof(T) of them; missing high bytes count as 0.
template <typename T>
T FromLittleEndian(absl::string_view bytes) {
  static_assert(std::is_integral_v<T>);
  using Bits = std::make_unsigned_t<T>;
  Bits bits = 0;
  for (size_t i = 0; i < bytes.size(); ++i) bits |= static_cast<Bits>(static_cast<uint8_t>(bytes[i])) << (8 * i);
  return static_cast<T>(bits);
}

}  // namespace craftfleet
