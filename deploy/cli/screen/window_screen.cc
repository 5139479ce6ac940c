#include "deploy/cli/screen/window_screen.h"

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <utility>

#include <absl/strings/str_cat.h>
#include <opencv2/highgui.hpp>

#include "deploy/cli/screen/view_picture.h"

namespace craftfleet {
namespace {

void MakeWindow(const std::string& title) { cv::namedWindow(title, cv::WINDOW_AUTOSIZE | cv::WINDOW_GUI_NORMAL); }

// Whether a child process can open a window. Its messages are dropped.
bool ChildOpensWindow() {
  const pid_t child = fork();
  if (child == 0) {
    const int nothing = open("/dev/null", O_WRONLY | O_CLOEXEC);
    dup2(nothing, STDERR_FILENO);
    dup2(nothing, STDOUT_FILENO);
    try {
      MakeWindow("craftfleet: trying the display");
    } catch (const cv::Exception&) {
      _exit(1);
    }
    _exit(0);
  }
  int result = 1;
  return child > 0 && waitpid(child, &result, 0) == child && WIFEXITED(result) && WEXITSTATUS(result) == 0;
}

class WindowScreen : public Screen {
 public:
  WindowScreen(std::string title, PictureRoom room) : title_(std::move(title)), room_(room) {}
  ~WindowScreen() override {
    try {
      cv::destroyWindow(title_);
    } catch (const cv::Exception&) {
      // The window is closed already.
    }
  }

  PictureRoom Room() const override { return room_; }

  absl::Status Show(const View& view) override {
    try {
      cv::imshow(title_, DrawView(view, room_));
    } catch (const cv::Exception& error) {
      return absl::InternalError(absl::StrCat("the window: ", error.what()));
    }
    return absl::OkStatus();
  }

  Key ReadKey(absl::Duration timeout) override {
    try {
      // waitKeyEx would wait forever at 0.
      const int code = cv::waitKeyEx(std::max(1, static_cast<int>(absl::ToInt64Milliseconds(timeout))));
      if (cv::getWindowProperty(title_, cv::WND_PROP_VISIBLE) < 1) return kCloseKey;
      return KeyFromWindow(code);
    } catch (const cv::Exception&) {
      return kCloseKey;
    }
  }

 private:
  const std::string title_;
  const PictureRoom room_;
};

}  // namespace

absl::Status TryDisplay() {
  const char* display = nullptr;
  for (const char* name : {"WAYLAND_DISPLAY", "DISPLAY"}) {
    if (const char* const value = std::getenv(name); value != nullptr && *value != '\0') display = value;
  }
  if (display == nullptr) {
    return absl::FailedPreconditionError(
        "there is no display: neither DISPLAY nor WAYLAND_DISPLAY is set; use --terminal");
  }
  if (!ChildOpensWindow()) {
    return absl::FailedPreconditionError(
        absl::StrCat("cannot open a window on the display ", display, "; use --terminal"));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Screen>> OpenWindow(const std::string& title, PictureRoom room) {
  try {
    MakeWindow(title);
  } catch (const cv::Exception& error) {
    return absl::InternalError(absl::StrCat("cannot open a window: ", error.what()));
  }
  return std::make_unique<WindowScreen>(title, room);
}

}  // namespace craftfleet
