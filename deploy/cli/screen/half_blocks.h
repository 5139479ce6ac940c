// Pictures as text: each character is two pixels, one above the other, in 24-bit colours.

#ifndef CRAFTFLEET_DEPLOY_CLI_SCREEN_HALF_BLOCKS_H_
#define CRAFTFLEET_DEPLOY_CLI_SCREEN_HALF_BLOCKS_H_

#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Lines of text with ANSI escapes for a picture uint8[height,width,3], (height + 1) / 2 of them, each `width`
// characters wide. If the height is odd, the last line is black below.
std::vector<std::string> HalfBlocks(absl::string_view picture, int width, int height);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SCREEN_HALF_BLOCKS_H_
