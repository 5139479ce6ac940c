// Tries the sound inputs of a target, then every file in the folders:
//   fuzz_NAME_replay FOLDER...
// Writes the sound inputs to files, as seeds of a search:
//   fuzz_NAME_replay --write_seeds FOLDER

#include <cstdio>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

absl::Status WriteSeeds(const std::string& folder) {
  const std::vector<std::string> inputs = SoundInputs();
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  for (size_t i = 0; i < inputs.size(); ++i) {
    CRAFTFLEET_RETURN_IF_ERROR(WriteFileSynced(JoinPath(folder, absl::StrCat("sound-", i)), inputs[i]));
  }
  std::printf("%zu sound inputs written to %s\n", inputs.size(), folder.c_str());
  return absl::OkStatus();
}

absl::Status Replay(const std::string& folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFolder(folder));
  if (names.empty()) return absl::NotFoundError(absl::StrCat("no inputs in ", folder));
  for (const std::string& name : names) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string input, ReadFile(JoinPath(folder, name)));
    TryInput(input);
  }
  std::printf("%zu inputs of %s replayed\n", names.size(), folder.c_str());
  return absl::OkStatus();
}

absl::Status Run(const std::vector<std::string>& arguments) {
  if (arguments.size() == 2 && arguments[0] == "--write_seeds") return WriteSeeds(arguments[1]);
  const std::vector<std::string> sound = SoundInputs();
  for (const std::string& input : sound) TryInput(input);
  std::printf("%zu sound inputs replayed\n", sound.size());
  for (const std::string& folder : arguments) CRAFTFLEET_RETURN_IF_ERROR(Replay(folder));
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const absl::Status status = craftfleet::Run({argv + 1, argv + argc});
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
