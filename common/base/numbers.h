// Numbers as text.

#pragma once

#include <cstdint>
#include <string>
#include <type_traits>

namespace craftfleet {

// The shortest text from which the same finite number is read: "10.3", "0.3333333333333333".
std::string ExactNumber(double value);

// `value` for messages: a floating-point number as ExactNumber, others as they are.
template <typename T>
auto Exactly(const T& value) {
  if constexpr (std::is_floating_point_v<T>) {
    return ExactNumber(value);
  } else {
    return value;
  }
}

// 1234567 -> "1,234,567"
std::string WithCommas(int64_t value);

}  // namespace craftfleet
