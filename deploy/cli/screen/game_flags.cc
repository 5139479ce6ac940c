#include "deploy/cli/screen/game_flags.h"

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/process/flag_values.h"
#include "common/process/shared_flags.h"
#include "deploy/cli/screen/terminal_screen.h"
#include "deploy/cli/screen/window_screen.h"

namespace craftfleet {

absl::StatusOr<EnvName> EnvFromFlag(const std::string& name) { return WithPrefix("--env", EnvName::Parse(name)); }

absl::StatusOr<std::shared_ptr<const Textures>> TexturesFromFlag(const std::string& folder) {
  if (folder.empty()) return Textures::BuiltIn();
  return WithPrefix(absl::StrCat("--textures=", folder), Textures::Load(folder));
}

absl::StatusOr<std::optional<AttentionChoice>> AttentionFromFlag() {
  const std::string text = absl::GetFlag(FLAGS_attention);
  if (text == "off") return std::optional<AttentionChoice>();
  return WithPrefix("--attention", AttentionChoice::Parse(text));
}

absl::Status CheckEpisodeAndSize(int64_t episode, int size) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange<int64_t>("episode", episode, 1, 1'000'000'000));
  return CheckFlagRange("size", size, 64, 1024);
}

absl::Status CheckScreen(bool terminal) {
  if (terminal) return TerminalScreen::Check();
#ifdef CRAFTFLEET_WITH_WINDOW
  return TryDisplay();
#else
  return absl::FailedPreconditionError("this build cannot open windows (CRAFTFLEET_WITH_WINDOW=OFF); use --terminal");
#endif
}

absl::StatusOr<std::unique_ptr<Screen>> OpenScreen(bool terminal, [[maybe_unused]] const std::string& title,
                                                   [[maybe_unused]] int size) {
  if (terminal) return TerminalScreen::Open();
#ifdef CRAFTFLEET_WITH_WINDOW
  return OpenWindow(title, {size, size});
#else
  return CheckScreen(terminal);
#endif
}

}  // namespace craftfleet
