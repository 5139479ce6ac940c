#include "common/base/numbers.h"

#include <array>
#include <charconv>
#include <system_error>

#include <absl/strings/str_cat.h>

#include "common/base/check.h"

namespace craftfleet {

std::string ExactNumber(double value) {
  std::array<char, 32> digits;
  const auto [end, error] = std::to_chars(digits.data(), digits.data() + digits.size(), value);
  CRAFTFLEET_CHECK(error == std::errc());
  return std::string(digits.data(), end);
}

std::string WithCommas(int64_t value) {
  std::string text = absl::StrCat(value);
  const int first_digit = value < 0 ? 1 : 0;
  for (int i = static_cast<int>(text.size()) - 3; i > first_digit; i -= 3) text.insert(i, ",");
  return text;
}

}  // namespace craftfleet
