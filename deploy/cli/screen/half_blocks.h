// Pictures as text: each character is two pixels, one above the other.

#pragma once

#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// The colours that a terminal shows.
enum class Colors { kTrue, k256, k16 };

// By the environment variables COLORTERM and TERM, as terminals set them: 24-bit colours only where a terminal names
// them, 256 where its name does, else 16. Null: not set.
Colors ColorsOf(const char* colorterm, const char* term);

// Lines of text with ANSI escapes for a picture uint8[height,width,3], (height + 1) / 2 of them, each `width`
// characters wide. If the height is odd, the last line is black below.
std::vector<std::string> HalfBlocks(absl::string_view picture, int width, int height, Colors colors = Colors::kTrue);

}  // namespace craftfleet
