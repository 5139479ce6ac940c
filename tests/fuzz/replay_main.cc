// Tries every input of a corpus, and the sound ones, once more: fuzz_NAME_replay [--write_seeds] CORPUS_FOLDER

#include <cstdio>
#include <string>

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/files.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

int WriteSeeds(const std::string& folder) {
  const std::vector<std::string> inputs = SoundInputs();
  for (size_t i = 0; i < inputs.size(); ++i) {
    absl::Status status = CreateFolders(folder);
    if (status.ok()) status = WriteFileSynced(JoinPath(folder, absl::StrCat("sound-", i)), inputs[i]);
    if (!status.ok()) {
      std::fprintf(stderr, "%s\n", status.ToString().c_str());
      return 1;
    }
  }
  std::printf("%zu sound inputs written to %s\n", inputs.size(), folder.c_str());
  return 0;
}

int Replay(const std::string& folder) {
  for (const std::string& input : SoundInputs()) TryInput(input);
  const absl::StatusOr<std::vector<std::string>> names = ListFolder(folder);
  if (!names.ok() || names->empty()) {
    std::fprintf(stderr, "no inputs in %s\n", folder.c_str());
    return 1;
  }
  for (const std::string& name : *names) {
    const absl::StatusOr<std::string> input = ReadFile(JoinPath(folder, name));
    if (!input.ok()) {
      std::fprintf(stderr, "%s\n", input.status().ToString().c_str());
      return 1;
    }
    TryInput(*input);
  }
  std::printf("%zu inputs replayed\n", names->size());
  return 0;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const bool write_seeds = argc == 3 && absl::string_view(argv[1]) == "--write_seeds";
  if (argc != 2 && !write_seeds) {
    std::fprintf(stderr, "usage: %s [--write_seeds] CORPUS_FOLDER\n", argv[0]);
    return 2;
  }
  return write_seeds ? craftfleet::WriteSeeds(argv[2]) : craftfleet::Replay(argv[1]);
}
