#include "common/process/flag_values.h"

#include <cctype>
#include <limits>
#include <optional>

#include <absl/strings/ascii.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/strip.h>

namespace craftfleet {
namespace {

constexpr int kMaxExponent = 18;  // 10^19 does not fit into 64 bits

// Removes the unit suffix of `text` and returns its power of ten: 3 for k, 6 for M, 9 for G, 0 without one.
int TakeSuffix(absl::string_view* text) {
  if (absl::ConsumeSuffix(text, "k") || absl::ConsumeSuffix(text, "K")) return 3;
  if (absl::ConsumeSuffix(text, "M")) return 6;
  return absl::ConsumeSuffix(text, "G") ? 9 : 0;
}

// Removes the exponent ("e6") of `text` and returns it; 0 without one, nullopt if it is malformed.
std::optional<int> TakeExponent(absl::string_view* text) {
  const size_t e = text->find_first_of("eE");
  if (e == absl::string_view::npos) return 0;
  absl::string_view digits = text->substr(e + 1);
  *text = text->substr(0, e);
  absl::ConsumePrefix(&digits, "+");
  int exponent = 0;
  if (digits.empty() || !absl::ascii_isdigit(digits[0]) || !absl::SimpleAtoi(digits, &exponent)) return std::nullopt;
  return exponent > kMaxExponent ? std::nullopt : std::optional<int>(exponent);
}

// `text` times ten to the power of `exponent`; nullopt unless that is a whole number of 64 bits.
std::optional<int64_t> Scaled(absl::string_view text, int exponent) {
  const size_t point = text.find('.');
  const absl::string_view whole = text.substr(0, point);
  absl::string_view fraction = point == absl::string_view::npos ? "" : text.substr(point + 1);
  if (point != absl::string_view::npos && fraction.empty()) return std::nullopt;
  while (absl::ConsumeSuffix(&fraction, "0")) {
  }
  if (fraction.size() > static_cast<size_t>(exponent)) return std::nullopt;
  // SimpleAtoi also accepts blanks and signs, which are allowed only in front.
  for (const char c : fraction) {
    if (!absl::ascii_isdigit(c)) return std::nullopt;
  }
  if (whole.empty() || !absl::ascii_isdigit(whole.back())) return std::nullopt;
  int64_t value = 0;
  const std::string digits = absl::StrCat(whole, fraction, std::string(exponent - fraction.size(), '0'));
  return absl::SimpleAtoi(digits, &value) ? std::optional<int64_t>(value) : std::nullopt;
}

}  // namespace

bool AbslParseFlag(absl::string_view text, Count* count, std::string* error) {
  absl::string_view rest = text;
  const int suffix = TakeSuffix(&rest);
  const std::optional<int> exponent = TakeExponent(&rest);
  std::optional<int64_t> value;
  if (exponent.has_value()) value = Scaled(rest, suffix + *exponent);
  if (!value.has_value()) {
    *error = Count::kWanted;
    return false;
  }
  count->value = *value;
  return true;
}

std::string AbslUnparseFlag(const Count& count) { return absl::StrCat(count.value); }

bool AbslParseFlag(absl::string_view text, TimeSpan* span, std::string* error) {
  double seconds = 0;
  if (absl::SimpleAtod(text, &seconds)) {
    span->value = absl::Seconds(seconds);
    return true;
  }
  if (absl::ParseDuration(text, &span->value)) return true;
  *error = TimeSpan::kWanted;
  return false;
}

std::string AbslUnparseFlag(const TimeSpan& span) { return absl::FormatDuration(span.value); }

bool AbslParseFlag(absl::string_view text, GivenAddress* given, std::string* /*error*/) {
  given->address = std::string(text);
  return true;
}

std::string AbslUnparseFlag(const GivenAddress& given) { return given.address.value_or(""); }

absl::Status CheckFlagRange(absl::string_view flag, absl::Duration value, absl::Duration low, absl::Duration high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return InvalidFlag(flag, absl::FormatDuration(value),
                     absl::StrCat(absl::FormatDuration(low), "..", absl::FormatDuration(high)));
}

}  // namespace craftfleet
