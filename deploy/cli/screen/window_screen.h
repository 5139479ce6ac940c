// A screen in a window of the desktop, by OpenCV.

#ifndef CRAFTFLEET_DEPLOY_CLI_SCREEN_WINDOW_SCREEN_H_
#define CRAFTFLEET_DEPLOY_CLI_SCREEN_WINDOW_SCREEN_H_

#include <memory>
#include <string>

#include <absl/status/statusor.h>

#include "deploy/cli/screen/screen.h"

namespace craftfleet {

// Opens a window with room for pictures of `room` and a column of text. A child process tries the display first,
// because the window system ends a process whose display does not answer.
//   FailedPrecondition: there is no display, or the build has no windows (CRAFTFLEET_WITH_WINDOW=OFF).
absl::StatusOr<std::unique_ptr<Screen>> OpenWindow(const std::string& title, PictureRoom room);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SCREEN_WINDOW_SCREEN_H_
