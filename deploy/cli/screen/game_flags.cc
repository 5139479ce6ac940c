#include "deploy/cli/screen/game_flags.h"

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>

#include "common/process/flag_check.h"
#include "common/process/shared_flags.h"
#include "deploy/cli/screen/terminal_screen.h"
#include "deploy/cli/screen/window_screen.h"

namespace craftfleet {

absl::StatusOr<EnvName> EnvFromFlag(const std::string& name) {
  absl::StatusOr<EnvName> env = EnvName::Parse(name);
  if (env.ok()) return env;
  return absl::InvalidArgumentError(absl::StrCat("--env: ", env.status().message()));
}

absl::StatusOr<std::shared_ptr<const Textures>> TexturesFromFlag(const std::string& folder) {
  if (folder.empty()) return Textures::BuiltIn();
  absl::StatusOr<std::shared_ptr<const Textures>> textures = Textures::Load(folder);
  if (textures.ok()) return textures;
  return absl::Status(textures.status().code(), absl::StrCat("--textures=", folder, ": ", textures.status().message()));
}

absl::StatusOr<std::optional<AttentionChoice>> AttentionFromFlag() {
  const std::string text = absl::GetFlag(FLAGS_attention);
  if (text == "off") return std::optional<AttentionChoice>();
  absl::StatusOr<AttentionChoice> choice = AttentionChoice::Parse(text);
  if (!choice.ok()) return absl::InvalidArgumentError(absl::StrCat("--attention: ", choice.status().message()));
  return std::optional<AttentionChoice>(*choice);
}

absl::Status CheckEpisodeFlag(int64_t episode) { return CheckFlagRange<int64_t>("episode", episode, 1, 1'000'000'000); }

absl::Status CheckSizeFlag(int size) { return CheckFlagRange("size", size, 64, 1024); }

absl::Status CheckScreen(bool terminal) { return terminal ? absl::OkStatus() : TryDisplay(); }

absl::StatusOr<std::unique_ptr<Screen>> OpenScreen(bool terminal, const std::string& title, int size) {
  if (terminal) return TerminalScreen::Open();
  return OpenWindow(title, {size, size});
}

}  // namespace craftfleet
