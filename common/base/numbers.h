// Numbers as text.

#pragma once

#include <cstdint>
#include <string>

namespace craftfleet {

// The shortest text from which the same finite number is read: "10.3", "0.3333333333333333".
std::string ExactNumber(double value);

// 1234567 -> "1,234,567"
std::string WithCommas(int64_t value);

}  // namespace craftfleet
