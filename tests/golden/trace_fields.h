// The fields of a trace line, taken from a world. Source: the README in CRAFTFLEET_GOLDEN_DIR, the table of keys.

#pragma once

#include <cstdint>
#include <string>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>
#include <nlohmann/json.hpp>

#include "envserver/world/world.h"

namespace craftfleet {

// zlib's crc32 as 8 lower-case hex digits.
std::string CrcText(absl::string_view bytes);
std::string CrcText(absl::Span<const uint8_t> bytes);

// All fields of the state, in the order of the table: `ep` to `mtp`, then `mvar` and `ovar`; without `img`.
nlohmann::ordered_json TraceFields(const World& world);

}  // namespace craftfleet
