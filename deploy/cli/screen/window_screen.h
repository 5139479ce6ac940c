// A screen in a window of the desktop, by OpenCV.

#pragma once

#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "deploy/cli/screen/screen.h"

namespace craftfleet {

// Whether windows can be opened. A child process tries it, because the window system ends a process whose display does
// not answer. To be called before other threads start: a child of several threads may wait forever for a lock of one of
// them.
//   FailedPrecondition: there is no display.
absl::Status TryDisplay();

// Opens a window with room for pictures of `room` and a column of text, after TryDisplay.
//   Internal: it can't be opened.
absl::StatusOr<std::unique_ptr<Screen>> OpenWindow(const std::string& title, PictureRoom room);

}  // namespace craftfleet
