// Replaces window_screen.cc in builds with CRAFTFLEET_WITH_WINDOW=OFF: every window is refused.

#include "deploy/cli/screen/window_screen.h"

namespace craftfleet {

absl::Status TryDisplay() {
  return absl::FailedPreconditionError("this build cannot open windows (CRAFTFLEET_WITH_WINDOW=OFF); use --terminal");
}

absl::StatusOr<std::unique_ptr<Screen>> OpenWindow(const std::string& /*title*/, PictureRoom /*room*/) {
  return TryDisplay();
}

}  // namespace craftfleet
